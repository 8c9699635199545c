"""D455Noise: a wrapper that makes an environment's clean images look like a D455's."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Final

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import NDArray

from shape_obs.wrappers.env_protocol import Images
from shape_obs_envs.d455.camera import D455Camera
from shape_obs_envs.d455.colour import Light
from shape_obs_envs.d455.depth import Measurement
from shape_obs_envs.d455.model import D455Model

#: Keeps the noise apart from what the environment draws from the same seed.
_STREAM: Final = 0xD455
_MILLIMETRES: Final = 1000


class D455Noise(gym.ObservationWrapper[Any, Any, Any], RecordConstructorArgs):
    """Adds the errors of an Intel RealSense D455 to the images of an RGB-D environment; see docs/d455-noise.md.

    Depth gets noise, disparity steps and holes (0); colour gets noise, and exposure and white balance that are drawn
    for each episode. Types and spaces stay as they are; all else in the observation is passed on. A plain RGB image
    observation gets the colour part alone.

    `reset(seed=...)` makes the noise repeatable; without a seed it goes on with its own random numbers.

    Args:
        env: Its observation is a Dict with an RGB image and, maybe, depth, (H, W) or (H, W, 1), in uint16 millimetres
            or float metres; or an RGB image.
        model: A `D455Model`, or a mapping of the fields that differ from its defaults.
        fast: Cut the noise out of a bank that is drawn once instead of drawing every pixel of every frame: the same
            statistics in a fraction of the time.
        rgb_key: Key of the image, default "rgb".
        depth_key: Key of the depth image; default "depth" where there is one.

    Attributes:
        light: Exposure and white balance of the last observation.
        measurement: The last depth measurement, unrounded, with the causes of its holes; None without depth.

    Raises:
        ValueError: No such image in the observation, or an argument out of its range.

    Example:
        >>> env = D455Noise(gym.make("shape_obs_envs:ShapeObs/Cable-v0"))  # doctest: +SKIP
        >>> env = D455Noise(env, {"speckle_share": 0, "exposure": 0.2}, fast=False)  # doctest: +SKIP
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        model: D455Model | Mapping[str, Any] | None = None,
        *,
        fast: bool = True,
        rgb_key: str | None = None,
        depth_key: str | None = None,
    ) -> None:
        self.model = D455Model.from_dict({} if model is None else model)
        if not isinstance(fast, (bool, np.bool_)):
            raise ValueError(f"fast: expected True or False, got {fast!r}")
        given = {"model": None if model is None else self.model.to_dict(), "rgb_key": rgb_key, "depth_key": depth_key}
        given = {name: value for name, value in given.items() if value is not None}
        RecordConstructorArgs.__init__(self, fast=bool(fast), **given)
        gym.ObservationWrapper.__init__(self, env)
        self._images = Images.find(env.observation_space, rgb_key, depth_key)
        rgb, depth = _boxes(env.observation_space, self._images)
        self._rgb_space = _unless_wide(rgb, 255)
        farthest = math.inf if self.model.max_z is None else self.model.max_z
        most = 65535 if depth is None or depth.dtype == np.uint16 else farthest
        self._depth_space = None if depth is None else _unless_wide(depth, most)
        self.fast = bool(fast)
        self.light = Light()
        self.measurement: Measurement | None = None
        self._camera: D455Camera | None = None
        self._rng = np.random.default_rng()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment and draw the episode's light; a seed starts the noise anew."""
        observation, info = self.env.reset(seed=seed, options=options)
        if seed is not None:
            self._rng = np.random.default_rng((_STREAM, seed))
        self.light = Light.draw(self.model, self._rng)
        return self._look(observation), info

    def observation(self, observation: Any) -> Any:
        """A clean observation as the camera sees it; this takes the light one frame on."""
        self.light = self.light.later(self.model, self._rng)
        return self._look(observation)

    @property
    def compute_reward(self) -> Callable[[Any, Any, Any], Any]:
        """That of the goal-conditioned environment inside; as there, an attribute that others do not have."""
        return self.env.get_wrapper_attr("compute_reward")

    def _look(self, observation: Any) -> Any:
        # Made here and not in __init__: vector environments build one in the parent process only to read spaces.
        if self._camera is None:
            self._camera = D455Camera(self.model, self._images.size, self.fast)
        rgb, depth = self._images.read(observation)
        picture = _within(self._rgb_space, self._camera.colour(rgb, self.light, self._rng))
        if self._images.rgb_key is None:
            return picture
        seen = {**observation, self._images.rgb_key: picture}
        if depth is not None and self._images.depth_key is not None:
            self.measurement = self._camera.measure(_metres(depth, self._images.size), rgb, self._rng)
            measured = _like(self.measurement.metres, np.asarray(depth))
            seen[self._images.depth_key] = _within(self._depth_space, measured)
        return seen


def _boxes(space: spaces.Space[Any], images: Images) -> tuple[spaces.Box, spaces.Box | None]:
    """The spaces of the colour image, which `Images.find` has looked at, and of depth.

    Raises:
        ValueError: Depth is not what a depth camera gives.
    """
    rgb = space[images.rgb_key] if images.rgb_key is not None and isinstance(space, spaces.Dict) else space
    assert isinstance(rgb, spaces.Box)
    if images.depth_key is None or not isinstance(space, spaces.Dict):
        return rgb, None
    depth, where = space[images.depth_key], f"observation[{images.depth_key!r}]"
    if (
        not isinstance(depth, spaces.Box)
        or depth.shape not in (images.size, (*images.size, 1))
        or not (depth.dtype == np.uint16 or np.issubdtype(depth.dtype, np.floating))
    ):
        raise ValueError(
            f"{where} must be a depth image as large as the RGB image, Box(..., {images.size}, uint16) in millimetres "
            f"or of floats in metres, got {depth}. Pass depth_key= if it has another key."
        )
    if (depth.low > 0).any():
        raise ValueError(
            f"{where}: a hole is 0, which the space must admit, got low {depth.low.max()}. "
            "Put a wrapper below D455Noise that makes it Box(0, ...)."
        )
    return rgb, depth


def _metres(depth: NDArray[Any], size: tuple[int, int]) -> NDArray[Any]:
    depth = np.asarray(depth).reshape(size)
    return depth if depth.dtype != np.uint16 else np.multiply(depth, np.float32(1 / _MILLIMETRES), dtype=np.float32)


def _like(metres: NDArray[np.float32], depth: NDArray[Any]) -> NDArray[Any]:
    """Measured depth in the type and shape that the environment gives it in."""
    if depth.dtype == np.uint16:
        millimetres = metres * np.float32(_MILLIMETRES)
        metres = np.minimum(np.rint(millimetres, out=millimetres), 65535, out=millimetres)
    return metres.astype(depth.dtype).reshape(depth.shape)


def _within(space: spaces.Box | None, image: NDArray[Any]) -> NDArray[Any]:
    """The image, clipped to its space; None is a space that holds all there can be."""
    return image if space is None else np.clip(image, space.low, space.high, out=image)


def _unless_wide(space: spaces.Box, most: float) -> spaces.Box | None:
    """None for a space that holds all from 0 to `most`: clipping takes longer than the whole model."""
    return None if (space.low <= 0).all() and (space.high >= most).all() else space
