"""Weights of the errors of features: by the points that the features describe, or by their noise."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.features import Feature, FeatureContext
from shape_obs.geometry.topology import Topology

Array = npt.NDArray[np.float64]

_RESPONSE: Final = 0.05  # share of the response to the largest action that counts as noise


def geometric_weights(features: Sequence[Feature], layout: Topology, context: FeatureContext) -> Array | None:
    """Return the matrix from changes of features to changes of the points that they describe.

    Coefficients of a curve differ in their effect: one moves all points, another hardly any, and two may nearly cancel.
    As points, their errors are the visible ones. For point features the matrix is the identity.

    Args:
        features: The features in the order of the vector.
        layout: The topology of the shape.
        context: The context, as for the bounds of the features.

    Returns:
        A matrix (M, F) with M at most F; None if a feature cannot be turned back into points, or is not linear in them.
    """
    blocks = []
    for feature in features:
        if not feature.invertible:
            return None
        count = len(feature.bounds(layout, context)[0])
        back = partial(feature.reconstruct, layout=layout, context=context)
        origin = back(np.zeros(count)).ravel()
        columns = np.column_stack([back(unit).ravel() - origin for unit in np.eye(count)])
        if not np.allclose(back(np.arange(count)).ravel() - origin, columns @ np.arange(count)):
            return None
        # Only lengths matter, and the triangular factor has the same with fewer rows.
        blocks.append(np.linalg.qr(columns, mode="r") / np.sqrt(layout.size))
    out = np.zeros((sum(len(block) for block in blocks), sum(block.shape[1] for block in blocks)))
    row = column = 0
    for block in blocks:
        out[row : row + len(block), column : column + block.shape[1]] = block
        row, column = row + len(block), column + block.shape[1]
    return out


def noise_weights(still: npt.ArrayLike, jacobian: npt.ArrayLike) -> Array:
    """Return weights that scale each feature by its noise, plus a small share of its response to motions.

    Args:
        still: ``(T, F)`` features while nothing moved, T at least 3.
        jacobian: ``(F, A)`` response of the features to actions, which sets the scale if there is no noise.

    Returns:
        A diagonal matrix ``(F, F)``.
    """
    frames, matrix = np.asarray(still, dtype=np.float64), np.asarray(jacobian, dtype=np.float64)
    scale = np.hypot(np.std(frames, axis=0, ddof=1), _RESPONSE * np.linalg.norm(matrix, axis=1))

    known = scale > 0
    return np.diag(np.where(known, 1 / np.where(known, scale, 1.0), 0.0))
