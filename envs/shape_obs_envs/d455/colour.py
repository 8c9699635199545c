"""Colour as the camera gives it: exposure, white balance and noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.d455.fields import GRAIN_UNIT, Fields
from shape_obs_envs.d455.model import D455Model

#: Standard deviations of the noise are in fixed point: so much is one code value.
_CODE_UNIT: Final = 64

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Light:
    """Exposure and white balance at one moment, as natural logarithms: of all channels, red / green, blue / green.

    Args:
        episode: What was drawn for the episode.
        wander: How far it has drifted since.
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
        """The light of a new episode."""
        return cls(_triple(rng.standard_normal(3) * _spread(model)), _triple(_drift(model) * rng.standard_normal(3)))

    def later(self, model: D455Model, rng: np.random.Generator) -> Light:
        """The light one frame on: it wanders about the episode's, as far on average after any time."""
        if not model.drift:
            return self
        keep = np.exp(-1 / model.drift_frames)
        fresh = np.sqrt(1 - keep**2) * _drift(model) * rng.standard_normal(3)
        return replace(self, wander=_triple(keep * np.asarray(self.wander) + fresh))


class Colour:
    """Takes colour images of one size.

    Args:
        model: The camera.
        size: (H, W) of the images.
    """

    def __init__(self, model: D455Model, size: tuple[int, int]) -> None:
        deviation = np.sqrt(model.read**2 + model.shot * np.arange(256))
        self._noisy = bool(deviation.any())
        self._deviation = np.rint(_CODE_UNIT * deviation).astype(np.int16)
        self._work = np.empty((*size, 3), np.int16)

    def take(self, rgb: NDArray[np.uint8], light: Light, fields: Fields, rng: np.random.Generator) -> NDArray[np.uint8]:
        """The picture (H, W, 3) that is taken of a clean one in this light."""
        gains = light.gains
        # Channels above the sensor's range are clipped before noise, as they are in the sensor.
        seen = rgb if gains == (1.0, 1.0, 1.0) else np.asarray(cv2.transform(rgb, np.diag(gains)), np.uint8)
        if not self._noisy:
            return seen.copy() if seen is rgb else seen
        work = self._work
        cv2.LUT(seen, self._deviation, dst=work)
        cv2.multiply(work, fields.grain(rng), dst=work, scale=1 / (_CODE_UNIT * GRAIN_UNIT))
        np.add(work, seen, out=work)
        return np.clip(work, 0, 255, out=work).astype(np.uint8)


def _spread(model: D455Model) -> NDArray[np.float64]:
    return np.array([model.exposure, model.white_balance, model.white_balance])


def _drift(model: D455Model) -> NDArray[np.float64]:
    return model.drift * _spread(model)


def _triple(values: NDArray[np.float64]) -> Triple:
    first, second, third = values.tolist()
    return first, second, third
