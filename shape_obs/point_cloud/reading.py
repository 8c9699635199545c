"""Read a cloud from an array of points."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.frame import FARTHEST
from shape_obs.point_cloud.cloud import Cloud

Array = npt.NDArray[np.float64]

# Points farther from the middle than so many times the median do not belong to the object.
_FAR: Final = 12.0
_SOME: Final = 1000  # points from which the middle is estimated


def read_cloud(points: Any) -> Cloud:
    """Return the cloud of an array: ``(M, 3)``, or organised as ``(H, W, 3)``, floating metres.

    Raises:
        TypeError: No floating array.
        ValueError: Another shape.
    """
    if not isinstance(points, np.ndarray) or not np.issubdtype(points.dtype, np.floating):
        came = f"an array of {points.dtype}" if isinstance(points, np.ndarray) else type(points).__name__
        raise TypeError(
            f"points: expected a numpy array of floating metres, got {came}; scale millimetres by 0.001, and stack the "
            "fields of a PointCloud2: np.stack([cloud['x'], cloud['y'], cloud['z']], axis=-1)."
        )
    if points.ndim not in (2, 3) or points.shape[-1] != 3:
        raise ValueError(
            f"points: expected shape (M, 3) or (H, W, 3), got {points.shape}; of (M, 4) or more give points[:, :3]."
        )
    return Cloud(plausible(points.reshape(-1, 3)))


def plausible(points: npt.NDArray[np.floating[Any]]) -> Array:
    """Return the points that can belong to one object: finite, non-zero, not absurdly far off.

    Args:
        points: ``(M, 3)`` metres.
    """
    points = points.astype(np.float64)
    points = points[(np.abs(points) < FARTHEST).all(axis=1) & points.any(axis=1)]
    if not len(points):
        return points
    some = points[:: -(-len(points) // _SOME)]
    middle = np.median(some, axis=0)
    typical = np.median(np.sum((some - middle) ** 2, axis=1))
    offset = points - middle
    return points[np.einsum("md,md->m", offset, offset) <= _FAR**2 * typical]
