"""Depth as the stereo pair measures it: noise and rounding of disparity, and the pixels that are lost."""

from __future__ import annotations

import enum
import math
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.d455.fields import Fields, Size
from shape_obs_envs.d455.model import D455Model


class Cause(enum.IntFlag):
    """Why a pixel has no depth; there may be several reasons."""

    MISSING = 1  # the clean image has none either: 0, negative, infinite or not a number
    NEAR = 2
    FAR = 4
    LEFT_BAND = 8
    EDGE = 16
    DARK = 32
    SPECKLE = 64


class Measurement(NamedTuple):
    """One depth image.

    Attributes:
        metres: (H, W) float32 depth along the optical axis [m], 0 where there is none; not rounded to millimetres.
        causes: (H, W) uint8, bits of `Cause`; 0 where there is depth.
    """

    metres: NDArray[np.float32]
    causes: NDArray[np.uint8]

    def lost_to(self, cause: Cause) -> NDArray[np.bool_]:
        """(H, W) the pixels that this cause, or any of several joined by `|`, takes by itself."""
        return (self.causes & np.uint8(cause)) != 0


class Stereo:
    """Measures depth images of one size.

    Args:
        model: The camera.
        size: (H, W) of the images.
    """

    def __init__(self, model: D455Model, size: Size) -> None:
        self._model = model
        height, width = size
        scale, product = model.scale(height), model.disparity_at_one_metre
        # Disparity is counted in the steps that it is rounded to, here and below.
        self._unit = model.disparity_step or 1.0
        self._product = np.float32(product / self._unit)
        # Something at no disparity at all is never measured, whatever max_z.
        self._least = np.float32(self._product / model.max_z if model.max_z else 0.5 if model.disparity_step else 1e-3)
        self._most = np.float32(self._product / model.min_z if model.min_z else math.inf)
        reach, self._edge_probability = model.edge_reach(height)
        self._edge_kernel = np.ones((2 * reach - 1,) * 2, np.uint8)
        self._dark_table = _bytes([model.dark_probability(value) for value in range(256)])
        self._columns = np.zeros((1, 0), np.float32)
        if model.left_band:
            # A narrower image is a crop of the native one: the columns at its left are gone with part of the band.
            cropped = max(0.0, model.width - width / scale) / 2
            columns = cropped + (np.arange(width, dtype=np.float32) + 0.5) / scale
            self._columns = (columns / np.float32(self._unit))[None]
            self._columns = self._columns[:, self._columns[0] < self._most]
        self._disparity, self._work = np.empty(size, np.float32), np.empty(size, np.float32)

    def measure(
        self, metres: NDArray[Any], rgb: NDArray[np.uint8], fields: Fields, rng: np.random.Generator
    ) -> Measurement:
        """Measure a clean depth image (H, W) [m] with its clean colours (H, W, 3)."""
        model, disparity = self._model, self._disparity
        causes = np.zeros(disparity.shape, np.uint8)
        missing = self._match(metres)
        if missing is not None:
            _mark(causes, missing, Cause.MISSING)
        self._lose(causes, rgb, fields, rng)

        if model.subpixel:
            cv2.scaleAdd(fields.noise(rng), model.subpixel / self._unit, disparity, dst=disparity)
        if model.disparity_step:
            np.rint(disparity, out=disparity)
        if model.min_z:
            _mark(causes, disparity > self._most, Cause.NEAR)
        far = disparity < self._least
        if missing is not None:
            far &= ~missing
        _mark(causes, far, Cause.FAR)
        with np.errstate(divide="ignore", over="ignore"):
            np.divide(self._product, disparity, out=self._work)
        measured = cv2.copyTo(self._work, (causes == 0).view(np.uint8))
        return Measurement(np.asarray(measured, np.float32), causes)

    def _match(self, metres: NDArray[Any]) -> NDArray[np.bool_] | None:
        """Sets the true disparity, 0 where there is none; returns where that is, None for nowhere."""
        disparity = self._disparity
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            clean = np.asarray(metres, np.float32)
            np.divide(self._product, clean, out=disparity)
            if disparity.min() > 0 and disparity.max() < np.inf:  # neither holds with a NaN
                return None
        missing = ~((disparity > 0) & (disparity < np.inf))
        # As far as can be: an object before nothing has an edge too.
        np.copyto(disparity, 0, where=missing)
        return missing

    def _lose(
        self, causes: NDArray[np.uint8], rgb: NDArray[np.uint8], fields: Fields, rng: np.random.Generator
    ) -> None:
        """Mark what is lost by the scene itself: without partner, beside jumps, on dark surfaces, in speckle."""
        model, disparity, work = self._model, self._disparity, self._work
        if self._columns.size:
            left = slice(0, self._columns.size)
            _mark(causes[:, left], disparity[:, left] > self._columns, Cause.LEFT_BAND)
        if model.edge_share:
            # The second difference is as large as a jump on both its sides, and small on slopes, however steep they are
            # in a coarse image.
            cv2.Laplacian(disparity, cv2.CV_32F, dst=work, ksize=1, borderType=cv2.BORDER_REPLICATE)
            beside = (np.abs(work, out=work) > np.float32(model.edge_jump / self._unit)).view(np.uint8)
            if self._edge_kernel.size > 1:
                beside = np.asarray(cv2.dilate(beside, self._edge_kernel), np.uint8)
            beside &= (fields.uniform(rng) < _bytes([self._edge_probability])[0]).view(np.uint8)
            _mark(causes, beside, Cause.EDGE)
        if model.dark_share:
            red, green, blue = cv2.split(rgb)
            brightness = cv2.max(cv2.max(red, green), blue)
            _mark(causes, fields.uniform(rng) < cv2.LUT(brightness, self._dark_table), Cause.DARK)
        if model.speckle_share:
            _mark(causes, fields.speckle(rng), Cause.SPECKLE)


def _mark(causes: NDArray[np.uint8], where: NDArray[Any], cause: Cause) -> None:
    np.bitwise_or(causes, np.multiply(where.view(np.uint8), np.uint8(cause)), out=causes)


def _bytes(probabilities: list[float]) -> NDArray[np.uint8]:
    """Bounds that uniform numbers 0 to 254 lie below with these probabilities, to 1/255."""
    return np.rint(255 * np.asarray(probabilities)).astype(np.uint8)
