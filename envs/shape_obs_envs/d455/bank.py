"""The same random fields cut out of a bank that is drawn once: the fast form for training."""

from __future__ import annotations

import math
from functools import cached_property, lru_cache
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.d455.fields import Size, grain, smooth_normal
from shape_obs_envs.d455.model import D455Model

#: A layer is this much of a side larger than an image, at least so many pixels: room to shift the crops.
_MARGIN: Final = 0.25
_LEAST_MARGIN: Final = 128
_SEED: Final = 0xD455


class NoiseBank:
    """Layers of noise larger than an image; each is drawn when it is first asked for.

    A frame gets crops at random places, mirrored at random. Where a pattern could be recognised, in the disparity noise
    and the speckle of a plain surface, it is the sum of crops of two layers: the pairs number millions, and no pattern
    comes back or is seen to move. The layers hold mean, variance and shares exactly.

    Args:
        model: The camera.
        size: (H, W) of its images.
    """

    def __init__(self, model: D455Model, size: Size) -> None:
        self._model, self._scale = model, model.scale(size[0])
        height, width = (side + max(math.ceil(_MARGIN * side), _LEAST_MARGIN) for side in size)
        self._size = height, width

    @cached_property
    def noise(self) -> tuple[NDArray[np.float32], ...]:
        """Two layers, normal, of variance 1/2 each."""
        layers = [self._normal(self._model.correlation, k) for k in (0, 1)]
        return tuple((layer - layer.mean()) / (layer.std() * np.float32(math.sqrt(2))) for layer in layers)

    @cached_property
    def uniform(self) -> NDArray[np.uint8]:
        """One layer, 0 to 254, each as often as the others."""
        return (255 * _ranks(self._normal(self._model.hole_size, 2))).astype(np.uint8)

    @cached_property
    def speckle(self) -> tuple[NDArray[np.uint8], ...]:
        """Two layers of blobs, 0 or 1, that share the holes between them."""
        share = 1 - math.sqrt(1 - self._model.speckle_share)
        return tuple((_ranks(self._normal(self._model.speckle_size, k)) < share).view(np.uint8) for k in (3, 4))

    @cached_property
    def grain(self) -> NDArray[np.int16]:
        """One layer of three channels."""
        return grain((*self._size, 3), np.random.default_rng((_SEED, 5)))

    def _normal(self, spread: float, layer: int) -> NDArray[np.float32]:
        return smooth_normal(self._size, spread * self._scale, np.random.default_rng((_SEED, layer)))


@lru_cache(maxsize=4)
def noise_bank(model: D455Model, size: Size) -> NoiseBank:
    """The bank of a model and an image size (H, W): one for all environments of a process."""
    return NoiseBank(model, size)


class BankFields:
    """Fields from random crops and flips of a bank.

    Args:
        model: The camera.
        size: (H, W) of its images.
    """

    def __init__(self, model: D455Model, size: Size) -> None:
        self._size = size
        self._bank = noise_bank(model, size)
        self._normal = np.empty(size, np.float32), np.empty(size, np.float32)
        self._bytes = np.empty(size, np.uint8), np.empty(size, np.uint8)
        self._grain = np.empty((*size, 3), np.int16)

    def noise(self, rng: np.random.Generator) -> NDArray[np.float32]:
        """See `Fields`."""
        one, two = (self._crop(*pair, rng) for pair in zip(self._bank.noise, self._normal, strict=True))
        return np.add(one, two, out=self._normal[0])

    def uniform(self, rng: np.random.Generator) -> NDArray[np.uint8]:
        """See `Fields`."""
        return self._crop(self._bank.uniform, self._bytes[0], rng)

    def speckle(self, rng: np.random.Generator) -> NDArray[np.uint8]:
        """See `Fields`."""
        one, two = (self._crop(*pair, rng) for pair in zip(self._bank.speckle, self._bytes, strict=True))
        return np.bitwise_or(one, two, out=self._bytes[0])

    def grain(self, rng: np.random.Generator) -> NDArray[np.int16]:
        """See `Fields`."""
        return self._crop(self._bank.grain, self._grain, rng)

    def _crop(self, layer: NDArray[Any], out: NDArray[Any], rng: np.random.Generator) -> NDArray[Any]:
        """A part of the layer, mirrored at random; in `out`, unless it could be left where it is."""
        height, width = self._size
        down, right, way = rng.random(3).tolist()
        top, left = int(down * (layer.shape[0] - height + 1)), int(right * (layer.shape[1] - width + 1))
        crop, flip = layer[top : top + height, left : left + width], int(4 * way) - 1
        return crop if flip == 2 else np.asarray(cv2.flip(crop, flip, dst=out))  # -1: both ways


def _ranks(values: NDArray[np.float32]) -> NDArray[np.float64]:
    """The share of values that are smaller, for each value."""
    order = np.argsort(values, axis=None)
    ranks = np.empty(values.size)
    ranks[order] = np.arange(values.size) / values.size
    return ranks.reshape(values.shape)
