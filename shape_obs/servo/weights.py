"""What an error of features is worth: as the points that they stand for, or beside their noise."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.features import Feature, FeatureContext
from shape_obs.geometry.topology import Topology

Array = npt.NDArray[np.float64]

_ANSWER: Final = 0.05  # to the largest action


def geometric_weights(features: Sequence[Feature], layout: Topology, context: FeatureContext) -> Array | None:
    """The matrix from changes of features to changes of the points that they stand for.

    Coefficients of a curve are not alike: one moves all points, another hardly any, and two may nearly cancel. Seen as
    points their errors are what an eye would see. For points the matrix is the identity.

    Args:
        features: In the order of the vector.
        layout: Of the shape.
        context: As for the features' bounds.

    Returns:
        (M,F), M at most F; None where one of the features cannot be turned back into points, or does not depend on
        them linearly.
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
        # Only lengths matter: the triangle has them all in fewer rows.
        blocks.append(np.linalg.qr(columns, mode="r") / np.sqrt(layout.size))
    out = np.zeros((sum(len(block) for block in blocks), sum(block.shape[1] for block in blocks)))
    row = column = 0
    for block in blocks:
        out[row : row + len(block), column : column + block.shape[1]] = block
        row, column = row + len(block), column + block.shape[1]
    return out


def noise_weights(still: npt.ArrayLike, jacobian: npt.ArrayLike) -> Array:
    """Each feature as a multiple of its noise, and of a little of what it answers to motions.

    Args:
        still: (T,F) features while nothing moved, T at least 3.
        jacobian: (F,A) what they answer to actions: where there is no noise, that sets the scale.

    Returns:
        (F,F) diagonal.
    """
    frames, matrix = np.asarray(still, dtype=np.float64), np.asarray(jacobian, dtype=np.float64)
    scale = np.hypot(np.std(frames, axis=0, ddof=1), _ANSWER * np.linalg.norm(matrix, axis=1))
    known = scale > 0
    return np.diag(np.where(known, 1 / np.where(known, scale, 1.0), 0.0))
