"""The sensors of the camera: stereo depth with its noise and holes, and colour with exposure, balance and noise."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.d455.model import D455Model
from shape_obs_envs.d455.random_fields import GRAIN_UNIT, Fields, Size

#: One code value in the fixed-point standard deviations of the colour noise.
_CODE_UNIT: Final = 64

Triple = tuple[float, float, float]


class Cause(enum.IntFlag):
    """Reasons why a pixel has no depth; several may apply."""

    MISSING = 1  # the clean image has none: 0, negative, infinite or NaN
    NEAR = 2
    FAR = 4
    LEFT_BAND = 8
    EDGE = 16
    DARK = 32
    SPECKLE = 64


class Measurement(NamedTuple):
    """One depth image.

    Attributes:
        metres: Depth along the optical axis, shape ``(H, W)``, float32 in metres, 0 where there is none; not rounded to
            millimetres.
        causes: Bits of ``Cause``, shape ``(H, W)``, uint8; 0 where there is depth.
    """

    metres: NDArray[np.float32]
    causes: NDArray[np.uint8]

    def lost_to(self, cause: Cause) -> NDArray[np.bool_]:
        """Return a mask ``(H, W)`` of the pixels with this cause, or with any of several joined by ``|``."""
        return (self.causes & np.uint8(cause)) != 0


class Stereo:
    """The depth sensor for images of one size.

    Args:
        model: The camera model.
        size: Size ``(H, W)`` of the images.
    """

    def __init__(self, model: D455Model, size: Size) -> None:
        self._model = model
        height, width = size
        scale, product = model.scale(height), model.disparity_at_one_metre
        # Disparities are counted in rounding steps, here and below.
        self._unit = model.disparity_step or 1.0
        self._product = np.float32(product / self._unit)
        # Zero disparity is never measured, even if max_z is not set.
        self._least = np.float32(self._product / model.max_z if model.max_z else 0.5 if model.disparity_step else 1e-3)
        self._most = np.float32(self._product / model.min_z if model.min_z else math.inf)
        reach, self._edge_probability = model.edge_reach(height)
        self._edge_kernel = np.ones((2 * reach - 1,) * 2, np.uint8)
        self._dark_table = _thresholds([model.dark_probability(value) for value in range(256)])
        self._columns = np.zeros((1, 0), np.float32)
        if model.left_band:
            # A narrower image is a crop of the native one, so part of the band lies outside its left edge.
            cropped = max(0.0, model.width - width / scale) / 2
            columns = cropped + (np.arange(width, dtype=np.float32) + 0.5) / scale
            self._columns = (columns / np.float32(self._unit))[None]
            self._columns = self._columns[:, self._columns[0] < self._most]
        self._disparity, self._work = np.empty(size, np.float32), np.empty(size, np.float32)

    def measure(
        self, metres: NDArray[Any], rgb: NDArray[np.uint8], fields: Fields, rng: np.random.Generator
    ) -> Measurement:
        """Measure a clean depth image ``(H, W)`` in metres with its clean colours ``(H, W, 3)``."""
        model, disparity = self._model, self._disparity
        causes = np.zeros(disparity.shape, np.uint8)
        missing = self._set_true_disparity(metres)
        if missing is not None:
            _mark(causes, missing, Cause.MISSING)
        self._mark_holes(causes, rgb, fields, rng)

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

    def _set_true_disparity(self, metres: NDArray[Any]) -> NDArray[np.bool_] | None:
        """Set the true disparity, 0 where there is none; return a mask of those pixels, None if there are none."""
        disparity = self._disparity
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            clean = np.asarray(metres, np.float32)
            np.divide(self._product, clean, out=disparity)
            if disparity.min() > 0 and disparity.max() < np.inf:  # both are false with a NaN
                return None
        missing = ~((disparity > 0) & (disparity < np.inf))
        # As far away as possible: an object in front of nothing also has an edge.
        np.copyto(disparity, 0, where=missing)
        return missing

    def _mark_holes(
        self, causes: NDArray[np.uint8], rgb: NDArray[np.uint8], fields: Fields, rng: np.random.Generator
    ) -> None:
        """Mark the holes that the scene causes: the left band, depth edges, dark surfaces, speckle."""
        model, disparity, work = self._model, self._disparity, self._work
        if self._columns.size:
            left = slice(0, self._columns.size)
            _mark(causes[:, left], disparity[:, left] > self._columns, Cause.LEFT_BAND)
        if model.edge_share:
            # The second difference is as large as a jump on both its sides, and small on slopes, even on steep ones in
            # a coarse image.
            cv2.Laplacian(disparity, cv2.CV_32F, dst=work, ksize=1, borderType=cv2.BORDER_REPLICATE)
            edge = (np.abs(work, out=work) > np.float32(model.edge_jump / self._unit)).view(np.uint8)
            if self._edge_kernel.size > 1:
                edge = np.asarray(cv2.dilate(edge, self._edge_kernel), np.uint8)
            edge &= (fields.uniform(rng) < _thresholds([self._edge_probability])[0]).view(np.uint8)
            _mark(causes, edge, Cause.EDGE)
        if model.dark_share:
            red, green, blue = cv2.split(rgb)
            brightness = cv2.max(cv2.max(red, green), blue)
            _mark(causes, fields.uniform(rng) < cv2.LUT(brightness, self._dark_table), Cause.DARK)
        if model.speckle_share:
            _mark(causes, fields.speckle(rng), Cause.SPECKLE)


@dataclass(frozen=True)
class Light:
    """Exposure and white balance at one moment, as natural logarithms: all channels, red / green, blue / green.

    Args:
        episode: Values drawn for the episode.
        wander: Drift since then.
    """

    episode: Triple = (0.0, 0.0, 0.0)
    wander: Triple = (0.0, 0.0, 0.0)

    @property
    def gains(self) -> Triple:
        """Factors of the code values of red, green and blue."""
        every, red, blue = np.add(self.episode, self.wander).tolist()
        return float(np.exp(every + red)), float(np.exp(every)), float(np.exp(every + blue))

    @classmethod
    def draw(cls, model: D455Model, rng: np.random.Generator) -> Light:
        """Draw the light of a new episode."""
        return cls(_triple(rng.standard_normal(3) * _spread(model)), _triple(_drift(model) * rng.standard_normal(3)))

    def later(self, model: D455Model, rng: np.random.Generator) -> Light:
        """Return the light one frame later; it drifts around the episode's values with a stationary variance."""
        if not model.drift:
            return self
        keep = np.exp(-1 / model.drift_frames)
        fresh = np.sqrt(1 - keep**2) * _drift(model) * rng.standard_normal(3)
        return replace(self, wander=_triple(keep * np.asarray(self.wander) + fresh))


class Colour:
    """The colour sensor for images of one size.

    Args:
        model: The camera model.
        size: Size ``(H, W)`` of the images.
    """

    def __init__(self, model: D455Model, size: Size) -> None:
        deviation = np.sqrt(model.read**2 + model.shot * np.arange(256))
        self._noisy = bool(deviation.any())
        self._deviation = np.rint(_CODE_UNIT * deviation).astype(np.int16)
        self._work = np.empty((*size, 3), np.int16)

    def capture(
        self, rgb: NDArray[np.uint8], light: Light, fields: Fields, rng: np.random.Generator
    ) -> NDArray[np.uint8]:
        """Capture a clean image ``(H, W, 3)`` in this light."""
        gains = light.gains
        # Channels above the sensor's range are clipped before the noise is added, as in the sensor.
        seen = rgb if gains == (1.0, 1.0, 1.0) else np.asarray(cv2.transform(rgb, np.diag(gains)), np.uint8)
        if not self._noisy:
            return seen.copy() if seen is rgb else seen
        work = self._work
        cv2.LUT(seen, self._deviation, dst=work)
        cv2.multiply(work, fields.grain(rng), dst=work, scale=1 / (_CODE_UNIT * GRAIN_UNIT))
        np.add(work, seen, out=work)
        return np.clip(work, 0, 255, out=work).astype(np.uint8)


def _mark(causes: NDArray[np.uint8], where: NDArray[Any], cause: Cause) -> None:
    np.bitwise_or(causes, np.multiply(where.view(np.uint8), np.uint8(cause)), out=causes)


def _thresholds(probabilities: list[float]) -> NDArray[np.uint8]:
    """Return thresholds that uniform integers 0 to 254 fall below with these probabilities, to 1/255."""
    return np.rint(255 * np.asarray(probabilities)).astype(np.uint8)


def _spread(model: D455Model) -> NDArray[np.float64]:
    return np.array([model.exposure, model.white_balance, model.white_balance])


def _drift(model: D455Model) -> NDArray[np.float64]:
    return model.drift * _spread(model)


def _triple(values: NDArray[np.float64]) -> Triple:
    first, second, third = values.tolist()
    return first, second, third
