"""The border of a sheet on its map: where the density of its points has fallen to half."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter1d

from shape_obs.curve import arc_length, interpolate

Array = npt.NDArray[np.float64]

_PIXELS: Final = 150  # along the map's longer side
_UNDER_BLUR: Final = 20.0  # points that the blur averages over, so that chance makes no border
_MIN_BLUR: Final = 1.2  # pixels
_WIDER: Final = 3.0  # blurs: over which the density may change
_FINER: Final = 3  # the border is drawn on pixels so many times finer
_POINTS: Final = 300
_SMOOTH: Final = 2.0  # points


def border(flat: Array) -> Array:
    """The closed border of points on a map.

    Half the density of the interior marks the border without bias, whatever noise blurs it; a hull of the outermost
    points would grow with the noise.

    Args:
        flat: (M,2) metres, x right and y down.

    Returns:
        (P,2) metres, evenly spread, clockwise.
    """
    low, high = flat.min(axis=0), flat.max(axis=0)
    pixel = max(float((high - low).max()) / _PIXELS, 1e-9)
    area = max(float(len(np.unique(np.floor((flat - low) / (4 * pixel)), axis=0))) * 16, 1.0)
    blur = max(float(np.sqrt(_UNDER_BLUR * area / (4 * np.pi * len(flat)))), _MIN_BLUR)
    margin = int(np.ceil(3 * blur)) + 1
    at = np.floor((flat - low) / pixel).astype(int) + margin
    width, height = (int(size) for size in at.max(axis=0) + margin + 1)
    count = np.bincount(at[:, 1] * width + at[:, 0], minlength=width * height).reshape(height, width)
    density = _blurred(count.astype(np.float32), blur)
    inside = (density > 0.3 * np.median(density[count > 0])).astype(np.float32)
    around = _blurred(density * inside, _WIDER * blur) / np.maximum(_blurred(inside, _WIDER * blur), 1e-3)
    share = density / np.maximum(around, 1e-6)
    fine = cv2.resize(share, None, fx=_FINER, fy=_FINER, interpolation=cv2.INTER_LINEAR)
    found = cv2.findContours((fine >= 0.5).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    # Through the centres of the outermost pixels: half a fine pixel inside of the level.
    contour = max(found, key=cv2.contourArea).reshape(-1, 2).astype(np.float64)
    placed = ((contour + 0.5) / _FINER - margin) * pixel + low
    closed = np.concatenate([placed, placed[:1]])
    arc = arc_length(closed)
    even = interpolate(closed, arc, np.arange(_POINTS) * (arc[-1] / _POINTS))
    even = gaussian_filter1d(even, _SMOOTH, axis=0, mode="wrap")
    after = np.roll(even, -1, axis=0)
    turn = float(np.sum(even[:, 0] * after[:, 1] - even[:, 1] * after[:, 0]))
    return even if turn > 0 else even[::-1]


def _blurred(image: npt.NDArray[np.float32], sigma: float) -> npt.NDArray[np.float32]:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT), dtype=np.float32)
