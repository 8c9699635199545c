"""Random fields that the model needs, drawn pixel by pixel: the exact form."""

from __future__ import annotations

import math
from typing import Any, Final, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from shape_obs_envs.d455.model import D455Model

Size = tuple[int, int]
#: Colour noise is in fixed point: so much is one standard deviation.
GRAIN_UNIT: Final = 1024


class Fields(Protocol):
    """Fields of one image size (H, W). What is returned may be used again by the next call, and must not be changed."""

    def noise(self, rng: np.random.Generator) -> NDArray[np.float32]:
        """Disparity noise (H, W): normal, variance 1, correlated."""
        ...

    def uniform(self, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Uniform whole numbers (H, W), 0 to 254, correlated as holes are."""
        ...

    def speckle(self, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Blobs (H, W): 1 in them, else 0."""
        ...

    def grain(self, rng: np.random.Generator) -> NDArray[np.int16]:
        """Colour noise (H, W, 3): normal, standard deviation `GRAIN_UNIT`, independent."""
        ...


def smooth_normal(size: Size, spread: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Normal numbers of variance 1, smoothed by a Gaussian window of standard deviation `spread` [px]."""
    reach = math.ceil(3 * spread)
    white = rng.standard_normal((size[0] + 2 * reach, size[1] + 2 * reach), np.float32)
    if reach == 0:
        return white
    kernel = cv2.getGaussianKernel(2 * reach + 1, spread, cv2.CV_32F)
    kernel /= np.linalg.norm(kernel)  # keeps the variance, not the mean
    smooth = cv2.sepFilter2D(white, -1, kernel, kernel)
    # The margin goes: there the filter makes up its input.
    return np.asarray(smooth[reach:-reach, reach:-reach], np.float32)


def grain(shape: tuple[int, int, int], rng: np.random.Generator) -> NDArray[np.int16]:
    """Independent normal numbers of standard deviation `GRAIN_UNIT`."""
    normal = rng.standard_normal(shape, np.float32)
    normal *= GRAIN_UNIT
    return np.rint(normal, out=normal).astype(np.int16)


class DrawnFields:
    """Every pixel drawn anew for every frame.

    Args:
        model: The camera.
        size: (H, W) of its images.
    """

    def __init__(self, model: D455Model, size: Size) -> None:
        self._model, self._size = model, size
        self._scale = model.scale(size[0])

    def noise(self, rng: np.random.Generator) -> NDArray[np.float32]:
        """See `Fields`."""
        return smooth_normal(self._size, self._model.correlation * self._scale, rng)

    def uniform(self, rng: np.random.Generator) -> NDArray[np.uint8]:
        """See `Fields`."""
        normal: NDArray[Any] = smooth_normal(self._size, self._model.hole_size * self._scale, rng)
        return np.minimum(255 * ndtr(normal), 254).astype(np.uint8)

    def speckle(self, rng: np.random.Generator) -> NDArray[np.uint8]:
        """See `Fields`."""
        normal = smooth_normal(self._size, self._model.speckle_size * self._scale, rng)
        return (normal < np.float32(ndtri(self._model.speckle_share))).view(np.uint8)

    def grain(self, rng: np.random.Generator) -> NDArray[np.int16]:
        """See `Fields`."""
        return grain((*self._size, 3), rng)
