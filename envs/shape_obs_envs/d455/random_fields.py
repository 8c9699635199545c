"""Random fields of the noise model: drawn for each frame (exact), or cropped from a bank that is drawn once (fast)."""

from __future__ import annotations

import math
from functools import cached_property, lru_cache
from typing import Any, Final, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from shape_obs_envs.d455.model import D455Model

Size = tuple[int, int]
#: One standard deviation of the fixed-point colour noise.
GRAIN_UNIT: Final = 1024
#: Size of a layer of the bank beyond the image, to shift the crops: a fraction of each side, or a minimum in pixels.
_MARGIN: Final = 0.25
_LEAST_MARGIN: Final = 128
_SEED: Final = 0xD455


class Fields(Protocol):
    """Random fields of one image size (H, W). The next call may overwrite a result, and callers must not modify it."""

    def noise(self, rng: np.random.Generator) -> NDArray[np.float32]:
        """Return disparity noise ``(H, W)``: normal, variance 1, correlated."""
        ...

    def uniform(self, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Return uniform integers ``(H, W)`` from 0 to 254, correlated like holes."""
        ...

    def speckle(self, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Return blobs ``(H, W)``: 1 inside, 0 outside."""
        ...

    def grain(self, rng: np.random.Generator) -> NDArray[np.int16]:
        """Return colour noise ``(H, W, 3)``: normal, standard deviation ``GRAIN_UNIT``, independent."""
        ...


class DrawnFields:
    """Fields that are drawn pixel by pixel for each frame.

    Args:
        model: The camera model.
        size: Size ``(H, W)`` of the images.
    """

    def __init__(self, model: D455Model, size: Size) -> None:
        self._model, self._size = model, size
        self._scale = model.scale(size[0])

    def noise(self, rng: np.random.Generator) -> NDArray[np.float32]:
        """See ``Fields``."""
        return _smooth_normal(self._size, self._model.correlation * self._scale, rng)

    def uniform(self, rng: np.random.Generator) -> NDArray[np.uint8]:
        """See ``Fields``."""
        normal: NDArray[Any] = _smooth_normal(self._size, self._model.hole_size * self._scale, rng)
        return np.minimum(255 * ndtr(normal), 254).astype(np.uint8)

    def speckle(self, rng: np.random.Generator) -> NDArray[np.uint8]:
        """See ``Fields``."""
        normal = _smooth_normal(self._size, self._model.speckle_size * self._scale, rng)
        return (normal < np.float32(ndtri(self._model.speckle_share))).view(np.uint8)

    def grain(self, rng: np.random.Generator) -> NDArray[np.int16]:
        """See ``Fields``."""
        return _grain((*self._size, 3), rng)


class BankFields:
    """Fields from random crops and flips of a bank.

    Args:
        model: The camera model.
        size: Size ``(H, W)`` of the images.
    """

    def __init__(self, model: D455Model, size: Size) -> None:
        self._size = size
        self._bank = noise_bank(model, size)
        self._normal = np.empty(size, np.float32), np.empty(size, np.float32)
        self._bytes = np.empty(size, np.uint8), np.empty(size, np.uint8)
        self._grain = np.empty((*size, 3), np.int16)

    def noise(self, rng: np.random.Generator) -> NDArray[np.float32]:
        """See ``Fields``."""
        one, two = (self._crop(*pair, rng) for pair in zip(self._bank.noise, self._normal, strict=True))
        return np.add(one, two, out=self._normal[0])

    def uniform(self, rng: np.random.Generator) -> NDArray[np.uint8]:
        """See ``Fields``."""
        return self._crop(self._bank.uniform, self._bytes[0], rng)

    def speckle(self, rng: np.random.Generator) -> NDArray[np.uint8]:
        """See ``Fields``."""
        one, two = (self._crop(*pair, rng) for pair in zip(self._bank.speckle, self._bytes, strict=True))
        return np.bitwise_or(one, two, out=self._bytes[0])

    def grain(self, rng: np.random.Generator) -> NDArray[np.int16]:
        """See ``Fields``."""
        return self._crop(self._bank.grain, self._grain, rng)

    def _crop(self, layer: NDArray[Any], out: NDArray[Any], rng: np.random.Generator) -> NDArray[Any]:
        """Return a part of the layer, flipped at random; in ``out`` unless no flip was needed."""
        height, width = self._size
        down, right, way = rng.random(3).tolist()
        top, left = int(down * (layer.shape[0] - height + 1)), int(right * (layer.shape[1] - width + 1))
        crop, flip = layer[top : top + height, left : left + width], int(4 * way) - 1
        return crop if flip == 2 else np.asarray(cv2.flip(crop, flip, dst=out))  # -1: both ways


class NoiseBank:
    """Layers of noise that are larger than an image; each is drawn on first use.

    A frame uses crops at random positions, flipped at random. Disparity noise and speckle of a plain surface would
    reveal a repeated pattern, so each is the sum of crops from two layers: there are millions of pairs, and no pattern
    repeats or appears to move. The layers have the exact mean, variance and fractions.

    Args:
        model: The camera model.
        size: Size ``(H, W)`` of the images.
    """

    def __init__(self, model: D455Model, size: Size) -> None:
        self._model, self._scale = model, model.scale(size[0])
        height, width = (side + max(math.ceil(_MARGIN * side), _LEAST_MARGIN) for side in size)
        self._size = height, width

    @cached_property
    def noise(self) -> tuple[NDArray[np.float32], ...]:
        """Two normal layers of variance 1/2 each."""
        layers = [self._normal(self._model.correlation, k) for k in (0, 1)]
        return tuple((layer - layer.mean()) / (layer.std() * np.float32(math.sqrt(2))) for layer in layers)

    @cached_property
    def uniform(self) -> NDArray[np.uint8]:
        """One layer of integers from 0 to 254, all equally frequent."""
        return (255 * _ranks(self._normal(self._model.hole_size, 2))).astype(np.uint8)

    @cached_property
    def speckle(self) -> tuple[NDArray[np.uint8], ...]:
        """Two layers of blobs, 0 or 1, whose union has the fraction of speckle."""
        share = 1 - math.sqrt(1 - self._model.speckle_share)
        return tuple((_ranks(self._normal(self._model.speckle_size, k)) < share).view(np.uint8) for k in (3, 4))

    @cached_property
    def grain(self) -> NDArray[np.int16]:
        """One layer of three channels."""
        return _grain((*self._size, 3), np.random.default_rng((_SEED, 5)))

    def _normal(self, spread: float, layer: int) -> NDArray[np.float32]:
        return _smooth_normal(self._size, spread * self._scale, np.random.default_rng((_SEED, layer)))


@lru_cache(maxsize=4)
def noise_bank(model: D455Model, size: Size) -> NoiseBank:
    """Return the bank of a model and an image size ``(H, W)``, which all environments of a process share."""
    return NoiseBank(model, size)


def _smooth_normal(size: Size, spread: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return normal numbers of variance 1, smoothed by a Gaussian of standard deviation ``spread`` in pixels."""
    reach = math.ceil(3 * spread)
    white = rng.standard_normal((size[0] + 2 * reach, size[1] + 2 * reach), np.float32)
    if reach == 0:
        return white
    kernel = cv2.getGaussianKernel(2 * reach + 1, spread, cv2.CV_32F)
    kernel /= np.linalg.norm(kernel)  # preserves the variance, not the mean
    smooth = cv2.sepFilter2D(white, -1, kernel, kernel)
    # Cut off the margin, where the filter extrapolates its input.
    return np.asarray(smooth[reach:-reach, reach:-reach], np.float32)


def _grain(shape: tuple[int, int, int], rng: np.random.Generator) -> NDArray[np.int16]:
    """Return independent normal numbers of standard deviation ``GRAIN_UNIT``."""
    normal = rng.standard_normal(shape, np.float32)
    normal *= GRAIN_UNIT
    return np.rint(normal, out=normal).astype(np.int16)


def _ranks(values: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return for each value the fraction of values that are smaller."""
    order = np.argsort(values, axis=None)
    ranks = np.empty(values.size)
    ranks[order] = np.arange(values.size) / values.size
    return ranks.reshape(values.shape)
