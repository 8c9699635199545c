"""Make clean RGB-D images look like those of a D455: image by image, or as a wrapper around an environment."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import NDArray

from shape_obs.wrappers.env_images import Images, Key
from shape_obs_envs.d455.model import D455Model
from shape_obs_envs.d455.random_fields import BankFields, DrawnFields
from shape_obs_envs.d455.sensors import Colour, Light, Measurement, Stereo

#: Separates the noise from the environment's random numbers of the same seed.
_STREAM: Final = 0xD455
_MILLIMETRES: Final = 1000


class D455Camera:
    """Measure clean images of one size as a D455 would.

    All randomness comes from the generator that is passed. The camera keeps no state between calls, but reuses its
    buffers: use one per thread.

    Args:
        model: The camera model.
        size: Size ``(H, W)`` of the images in pixels.
        fast: Crop random fields from a bank instead of drawing each pixel. The statistics are the same, at a fraction
            of the time; the bank takes 8 MB at 640 x 480 and is shared by all cameras of this model and size in a
            process.

    Raises:
        ValueError: ``size`` is not an image size.

    Example:
        >>> import numpy as np
        >>> camera, rng = D455Camera(D455Model(), (480, 640)), np.random.default_rng(0)
        >>> wall, white = np.full((480, 640), 1.0), np.full((480, 640, 3), 255, np.uint8)
        >>> metres, causes = camera.measure(wall, white, rng)
        >>> round(float(metres[causes == 0].std()), 3)
        0.002
    """

    def __init__(self, model: D455Model, size: Sequence[int], fast: bool = False) -> None:
        sides = [side for side in size if isinstance(side, (int, np.integer)) and side > 0]
        if len(size) != 2 or len(sides) != 2:
            raise ValueError(f"size: expected (height, width) in pixels, two whole numbers above 0, got {size!r}")
        self.model, self.size, self.fast = model, (int(sides[0]), int(sides[1])), bool(fast)
        self._stereo, self._colour = Stereo(model, self.size), Colour(model, self.size)
        self._fields = (BankFields if fast else DrawnFields)(model, self.size)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the arguments, without buffers and bank."""
        return type(self), (self.model, self.size, self.fast)

    def measure(self, metres: NDArray[Any], rgb: NDArray[np.uint8], rng: np.random.Generator) -> Measurement:
        """Measure depth.

        Args:
            metres: Clean depth along the optical axis, shape ``(H, W)``, of any float type, in metres; values that are
                0 or not finite mean no depth.
            rgb: Clean colours, shape ``(H, W, 3)``, uint8; they determine dark surfaces.
            rng: Random generator.

        Returns:
            Measured depth, not yet rounded to millimetres, and the causes of its holes.

        Raises:
            ValueError: An image has another shape or type.
        """
        metres = np.asarray(metres)
        if metres.shape != self.size or not np.issubdtype(metres.dtype, np.floating):
            raise ValueError(
                f"metres: expected {self.size} floats, got {metres.shape} {metres.dtype}. "
                "Divide millimetres by 1000.0; for another size make another D455Camera."
            )
        return self._stereo.measure(metres, self._checked(rgb), self._fields, rng)

    def colour(self, rgb: NDArray[np.uint8], light: Light, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Capture a colour image.

        Args:
            rgb: Clean colours, shape ``(H, W, 3)``, uint8.
            light: Exposure and white balance, from ``Light.draw`` and ``Light.later``.
            rng: Random generator.

        Returns:
            A new uint8 image of shape ``(H, W, 3)``.

        Raises:
            ValueError: The image has another shape or type.
        """
        return self._colour.capture(self._checked(rgb), light, self._fields, rng)

    def _checked(self, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
        rgb = np.asarray(rgb)
        if rgb.shape != (*self.size, 3) or rgb.dtype != np.uint8:
            raise ValueError(
                f"rgb: expected {(*self.size, 3)} uint8, got {rgb.shape} {rgb.dtype}. "
                "For another size make another D455Camera."
            )
        return np.ascontiguousarray(rgb)


class D455Noise(gym.ObservationWrapper[Any, Any, Any], RecordConstructorArgs):
    """Add the errors of an Intel RealSense D455 to the images of an RGB-D environment.

    Depth gets noise, disparity steps and holes (0); colour gets noise, and an exposure and white balance that are drawn
    for each episode. Types and spaces stay the same; the rest of the observation is passed through. A plain RGB image
    observation gets the colour part only.

    ``reset(seed=...)`` makes the noise repeatable; without a seed it continues its random sequence.

    Args:
        env: Environment whose observation is an RGB image, or a Dict with an RGB image and optionally depth of shape
            ``(H, W)`` or ``(H, W, 1)``, in uint16 millimetres or floating-point metres.
        model: A ``D455Model``, or a mapping of the fields that differ from its defaults.
        fast: Crop the noise from a bank that is drawn once instead of drawing each pixel of each frame: the same
            statistics at a fraction of the time.
        rgb_key: Key of the image, as ``ShapeObservation`` takes it; default "rgb".
        depth_key: Key of the depth image; default "depth" if present.

    Attributes:
        light: Exposure and white balance of the last observation.
        measurement: The last depth measurement, not rounded, with the causes of its holes; None without depth.

    Raises:
        ValueError: The observation has no such image, or an argument is out of its range.

    Example:
        >>> env = D455Noise(gym.make("shape_obs_envs:ShapeObs/Cable-v0"))  # doctest: +SKIP
        >>> env = D455Noise(env, {"speckle_share": 0, "exposure": 0.2}, fast=False)  # doctest: +SKIP
    """

    light: Light
    measurement: Measurement | None

    def __init__(
        self,
        env: gym.Env[Any, Any],
        model: D455Model | Mapping[str, Any] | None = None,
        *,
        fast: bool = True,
        rgb_key: Key | None = None,
        depth_key: Key | None = None,
    ) -> None:
        self.model = D455Model.from_dict({} if model is None else model)
        if not isinstance(fast, (bool, np.bool_)):
            raise ValueError(f"fast: expected True or False, got {fast!r}")
        given = {"model": None if model is None else self.model.to_dict(), "rgb_key": rgb_key, "depth_key": depth_key}
        given = {name: value for name, value in given.items() if value is not None}
        RecordConstructorArgs.__init__(self, fast=bool(fast), **given)
        gym.ObservationWrapper.__init__(self, env)
        self._images = Images.find(env.observation_space, rgb_key, depth_key)
        rgb, depth = _boxes(self._images)
        self._rgb_space = _clipping_space(rgb, 255)
        farthest = math.inf if self.model.max_z is None else self.model.max_z
        most = 65535 if depth is None or depth.dtype == np.uint16 else farthest
        self._depth_space = None if depth is None else _clipping_space(depth, most)
        self.fast = bool(fast)
        self.light = Light()
        self.measurement = None
        self._camera: D455Camera | None = None
        self._rng = np.random.default_rng()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment and draw the episode's light; a seed restarts the noise."""
        observation, info = self.env.reset(seed=seed, options=options)
        if seed is not None:
            self._rng = np.random.default_rng((_STREAM, seed))
        self.light = Light.draw(self.model, self._rng)
        return self._capture(observation), info

    def observation(self, observation: Any) -> Any:
        """Return a clean observation as the camera sees it, and advance the light by one frame."""
        self.light = self.light.later(self.model, self._rng)
        return self._capture(observation)

    @property
    def compute_reward(self) -> Callable[[Any, Any, Any], Any]:
        """The method of a goal-conditioned environment; other environments do not have the attribute."""
        return self.env.get_wrapper_attr("compute_reward")

    def _capture(self, observation: Any) -> Any:
        # Made here and not in __init__: vector environments build one in the parent process only to read its spaces.
        if self._camera is None:
            self._camera = D455Camera(self.model, self._images.size, self.fast)
        rgb, depth = self._images.read(observation)
        captured = _clip(self._rgb_space, self._camera.colour(rgb, self.light, self._rng))
        if depth is None or self._images.depth is None:
            return self._images.replaced(observation, captured, None)
        self.measurement = self._camera.measure(_in_metres(depth), rgb, self._rng)
        measured = _in_format_of(depth, self.measurement.metres).reshape(self._images.depth.space.shape)
        return self._images.replaced(observation, captured, _clip(self._depth_space, measured))


def _boxes(images: Images) -> tuple[spaces.Box, spaces.Box | None]:
    """Return the spaces of the colour image and of the depth image.

    Raises:
        ValueError: An image does not lie as a camera's, or has no room for holes.
    """
    rgb, depth = images.rgb.space, images.depth
    if images.rgb.steps or images.rgb.factor:
        raise ValueError(f"D455Noise: the RGB image must be Box(0, 255, (H, W, 3), uint8), got {rgb}.")
    if depth is not None and depth.space.dtype == np.int16:
        raise ValueError("D455Noise: the depth image is int16. Put a wrapper below that makes uint16 of it.")
    if depth is not None and (depth.space.low > 0).any():
        raise ValueError(
            f"the depth image: a hole is 0, which the space must contain, got low {depth.space.low.max()}. "
            "Put a wrapper below D455Noise that makes it Box(0, ...)."
        )
    return rgb, None if depth is None else depth.space


def _in_metres(depth: NDArray[Any]) -> NDArray[Any]:
    return depth if depth.dtype != np.uint16 else np.multiply(depth, np.float32(1 / _MILLIMETRES), dtype=np.float32)


def _in_format_of(depth: NDArray[Any], metres: NDArray[np.float32]) -> NDArray[Any]:
    """Return measured depth in the type of the environment's depth."""
    if depth.dtype == np.uint16:
        millimetres = metres * np.float32(_MILLIMETRES)
        metres = np.minimum(np.rint(millimetres, out=millimetres), 65535, out=millimetres)
    return metres.astype(depth.dtype)


def _clip(space: spaces.Box | None, image: NDArray[Any]) -> NDArray[Any]:
    """Clip an image to its space; None needs no clipping."""
    return image if space is None else np.clip(image, space.low, space.high, out=image)


def _clipping_space(space: spaces.Box, most: float) -> spaces.Box | None:
    """Return the space unless it contains all of 0 to ``most``: clipping takes longer than the whole model."""
    return None if (space.low <= 0).all() and (space.high >= most).all() else space
