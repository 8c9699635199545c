"""What goes wrong on purpose: black frames, and points that are lost at random."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from shape_obs.bench.servo.settings import Disturbance
from shape_obs.detector import ShapeDetector
from shape_obs.shape import Detection, Shape

Mask = npt.NDArray[np.bool_]

#: Keeps what is lost apart from what the environment draws from the same seed.
_STREAM: Final = 0x1057


class Disturbed(gym.ObservationWrapper[Any, Any, Any]):
    """Blacks out frames of an RGB-D env, and draws which points are lost, the same in each episode of one seed.

    Args:
        env: Its observation has ``rgb`` and ``depth``.
        disturbance: What goes wrong.

    Attributes:
        dark: Whether the last frame was black.
    """

    def __init__(self, env: gym.Env[Any, Any], disturbance: Disturbance) -> None:
        super().__init__(env)
        disturbance.check()
        self._disturbance = disturbance
        self._rng = np.random.default_rng(_STREAM)
        self._step = 0
        self.dark = False

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the env; a seed starts anew what is drawn."""
        if seed is not None:
            self._rng = np.random.default_rng((_STREAM, seed))
        self._step = -1
        return super().reset(seed=seed, options=options)

    def observation(self, observation: Any) -> Any:
        """The observation, black where it should be; this takes the disturbance one frame on."""
        self._step += 1
        first, count = self._disturbance.blackout or (0, 0)
        self.dark = first <= self._step < first + count
        if not self.dark:
            return observation
        return {**observation, **{key: np.zeros_like(observation[key]) for key in ("rgb", "depth")}}

    def lost(self, count: int) -> Mask:
        """(count,) which points are lost in this frame."""
        return self._rng.random(count) < self._disturbance.invalid


class LosingDetector(ShapeDetector):
    """A detector that loses points which it has found, and fills them in along the layout from the others.

    Args:
        lost: How many points there are -> (N,) which of them are lost.
        config: As of any detector.
    """

    def __init__(self, lost: Callable[[int], Mask], **config: Any) -> None:
        self._lost = lost
        super().__init__(**config)

    def detect(self, *args: Any, **options: Any) -> Detection:
        """As of any detector, but for the points that are lost."""
        detection = super().detect(*args, **options)
        return replace(detection, shapes=tuple(without(shape, self._lost(len(shape))) for shape in detection))


def without(shape: Shape, lost: Mask) -> Shape:
    """A shape with some of its points neither visible nor valid, but interpolated; one that is held stays as it is.

    Args:
        shape: What was found.
        lost: (N,) which points; if no valid one would be left, none.
    """
    left = shape.valid & ~lost
    if shape.reason or not left.any():
        return shape
    known = ~lost
    return replace(
        shape,
        points2d=shape.layout.interpolate(shape.pixels, known),
        points3d=None if shape.points3d is None else shape.layout.interpolate(shape.points3d, known),
        visible=shape.visible & ~lost,
        valid=left,
    )
