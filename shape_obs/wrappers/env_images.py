"""The images in an env's observation: where they are, how they lie, and whether they keep what their space promises."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from shape_obs.frame import plain_array
from shape_obs.spec import did_you_mean
from shape_obs.utils.image_layout import Step, is_depth, shape_after, steps_to_depth, steps_to_rgb

#: A key of an observation, or the keys on the way to an image in a Dict within a Dict: ``"images/rgb"`` as well.
Key = str | int | Sequence[str | int]
Path = tuple[str | int, ...]

_FULL: Final = 255
_OTHER_SCALE: Final = (-0.5, 2.0)  # of full scale; values beyond are no rounding or overshoot of a resized image
_BRIGHT: Final = 0.5  # of an image in 0...1; one in 0...255 with nothing but fractions up to this is a dark one
_STATE: Final = "For state observations add images first, e.g. with gymnasium.wrappers.AddRenderObservation."
_STACKED: Final = "These look like stacked frames: put ShapeObservation below the wrapper that stacks them."
_RESCALE: Final = (
    "Make its values uint8 0...255, or floats 0...1 with these bounds in the space, and give depth its own key, e.g. "
    "with gymnasium.wrappers.TransformObservation."
)


@dataclass
class Image:
    """An image in an observation.

    Args:
        path: The keys on the way to it; empty if the observation is the image.
        space: Its space.
        steps: What makes ``(H, W, 3)`` or ``(H, W)`` of it.
        factor: Of floats, what makes 0...255 of them; 0 leaves the values as they are.

    Attributes:
        where: The path in words.
        warned: Whether it was said that its values are on another scale.
    """

    path: Path
    space: spaces.Box
    steps: Sequence[Step]
    factor: float = 0.0
    warned: bool = field(default=False, init=False, compare=False)

    def __post_init__(self) -> None:
        self.where = _where(self.path)

    @property
    def size(self) -> tuple[int, int]:
        """``(H, W)`` in pixels."""
        height, width, *_ = shape_after(self.space.shape, self.steps)
        return height, width

    def read(self, observation: Any, masked: float | None = None) -> npt.NDArray[Any]:
        """Return the image in an observation: ``(H, W, 3)`` uint8, or ``(H, W)`` as it is stored.

        Args:
            observation: The env's.
            masked: The value of what a masked array hides; None refuses it.

        Raises:
            KeyError: The observation lacks a key.
            ValueError: The image has another shape, type or range than its space.
        """
        given, key = observation, None
        try:
            for key in self.path:
                given = given[key]
        except (KeyError, IndexError, TypeError) as error:
            got = f"keys: {sorted(given)}" if isinstance(given, Mapping) else f"it is a {type(given).__name__}"
            raise KeyError(f"the observation has no {key!r}, but its space does; {got}.") from error
        image, shape, dtype = given, self.space.shape, self.space.dtype
        if type(image) is not np.ndarray or image.shape != shape or image.dtype != dtype:
            image = plain_array(image, self.where, masked)
            if isinstance(image, np.ndarray) and [n for n in image.shape if n > 1] == [n for n in shape if n > 1]:
                image = image.reshape(shape)  # an axis of length 1 more or less changes nothing
            floats = isinstance(image, np.ndarray) and image.dtype.kind == "f" and np.issubdtype(dtype, np.floating)
            if not isinstance(image, np.ndarray) or image.shape != shape or (image.dtype != dtype and not floats):
                came = f"{image.shape} {image.dtype}" if isinstance(image, np.ndarray) else type(image).__name__
                raise ValueError(
                    f"{self.where}: the env's observation_space promises {shape} {dtype}, but the image is {came}: "
                    "correct the one or the other."
                )
        if self.factor:
            image = self._as_bytes(image)
        for step in self.steps:
            image = step.apply(image)
        return image

    def _as_bytes(self, image: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
        low, high = float(image.min()), float(image.max())
        full = _FULL / self.factor
        if not _OTHER_SCALE[0] * full <= low <= high <= _OTHER_SCALE[1] * full:
            raise ValueError(
                f"{self.where}: the env's observation_space promises values from 0 to {full:g}, "
                f"but those of the image lie from {low:g} to {high:g}: correct the one or the other."
            )
        if full > 1 and not self.warned and _BRIGHT < high <= 1 and (image % 1).any():
            self.warned = True
            warnings.warn(
                f"{self.where}: the env's observation_space goes up to {full:g}, but the values of the image "
                "are fractions up to 1, which is black: multiply them by 255, or give the space these bounds. This "
                "warning is shown once.",
                stacklevel=5,
            )
        return np.rint(np.clip(self.factor * image, 0, _FULL)).astype(np.uint8)


@dataclass(frozen=True)
class Images:
    """The images in an env's observation.

    Colours may be uint8, floats in 0...1 or numbers in 0...255, as ``(H, W, 3)``, ``(3, H, W)``, with an opacity as
    fourth channel, or gray; depth uint16 or int16 in millimetres or floats in metres, as ``(H, W)``,
    ``(H, W, 1)`` or ``(1, H, W)``. All may have a leading 1, a batch of one.

    Args:
        rgb: The colour image.
        depth: The depth image, as large as the colour image; None without.
    """

    rgb: Image
    depth: Image | None

    @classmethod
    def find(cls, space: spaces.Space[Any], rgb_key: Key | None = None, depth_key: Key | None = None) -> Images:
        """Find the images in an observation space; the defaults are ``"rgb"``, and ``"depth"`` next to it if any.

        Warns:
            UserWarning: The ``"depth"`` next to it is an image that is no depth of it; it is left out.

        Raises:
            ValueError: There is no image under a key; the message lists the keys.
        """
        if not isinstance(space, (spaces.Dict, spaces.Tuple)):
            for name, key in (("rgb_key", rgb_key), ("depth_key", depth_key)):
                if key is not None:
                    raise ValueError(f"{name}={key!r}: the observation has no keys, it is {space}; leave {name} out.")
            return cls(_rgb((), space), None)
        path, at = _find(space, "rgb_key", "rgb" if rgb_key is None else rgb_key)
        rgb = _rgb(path, at)
        if depth_key is not None:
            return cls(rgb, _depth(*_find(space, "depth_key", depth_key), rgb.size))
        around = _at(space, path[:-1])
        neighbour = around.spaces.get("depth") if isinstance(around, spaces.Dict) else None
        if not isinstance(neighbour, spaces.Box) or len(neighbour.shape) < 2:
            return cls(rgb, None)
        try:
            return cls(rgb, _depth((*path[:-1], "depth"), neighbour, rgb.size))
        except ValueError as error:
            warnings.warn(f"depth is left out: {error}", stacklevel=3)
            return cls(rgb, None)

    @property
    def size(self) -> tuple[int, int]:
        """``(H, W)`` of the images in pixels."""
        return self.rgb.size

    @property
    def has_depth(self) -> bool:
        """Whether there is a depth image."""
        return self.depth is not None

    def read(self, observation: Any) -> tuple[npt.NDArray[np.uint8], npt.NDArray[Any] | None]:
        """Return the colour image and the depth image of an observation.

        Raises:
            KeyError: The observation lacks a key.
            ValueError: An image has another shape, type or range than its space.
        """
        return self.rgb.read(observation), None if self.depth is None else self.depth.read(observation, masked=0)

    def replaced(self, observation: Any, rgb: npt.NDArray[Any], depth: npt.NDArray[Any] | None) -> Any:
        """Return an observation with other images, which must lie as its own do; a depth of None leaves its own."""
        seen = _put(observation, self.rgb.path, rgb)
        return seen if depth is None or self.depth is None else _put(seen, self.depth.path, depth)


def _put(value: Any, path: Path, image: npt.NDArray[Any]) -> Any:
    if not path:
        return image
    if isinstance(value, tuple):
        return tuple(_put(item, path[1:], image) if i == path[0] else item for i, item in enumerate(value))
    return {**value, path[0]: _put(value[path[0]], path[1:], image)}


def _find(space: spaces.Space[Any], name: str, key: Key) -> tuple[Path, spaces.Space[Any]]:
    """Return the path that a key describes, and the space there."""
    split = key.split("/") if isinstance(key, str) and key not in _children(space) else key
    parts: Path = (split,) if isinstance(split, (str, int)) else tuple(split)
    path: Path = ()
    for part in parts:
        known = _children(_at(space, path))
        part = int(part) if part not in known and str(part).isdigit() else part  # of a Tuple
        if part not in known:
            hint = did_you_mean("/".join(map(str, parts)), _leaves(space))
            raise ValueError(f"{name} {key!r} is not in the observation{hint} Pass rgb_key= and depth_key=.")
        path = (*path, part)
    return path, _at(space, path)


def _at(space: spaces.Space[Any], path: Path) -> spaces.Space[Any]:
    for key in path:
        space = _children(space)[key]
    return space


def _children(space: spaces.Space[Any]) -> dict[str | int, spaces.Space[Any]]:
    if isinstance(space, spaces.Dict):
        return {**space.spaces}
    return {**dict(enumerate(space.spaces))} if isinstance(space, spaces.Tuple) else {}


def _leaves(space: spaces.Space[Any], before: str = "") -> Iterator[str]:
    """Yield the paths to all that is neither a Dict nor a Tuple, with ``/`` between keys."""
    for key, child in _children(space).items():
        yield from _leaves(child, f"{before}{key}/") if _children(child) else [f"{before}{key}"]


def _where(path: Path) -> str:
    return "observation" + "".join(f"[{key!r}]" for key in path) if path else "the observation"


def _rgb(path: Path, space: spaces.Space[Any]) -> Image:
    """Return the colour image of a space.

    Raises:
        ValueError: It is none; the message gives the remedy.
    """
    shape = space.shape if isinstance(space, spaces.Box) else ()
    steps, factor = steps_to_rgb(shape), _factor(space) if isinstance(space, spaces.Box) else None
    if isinstance(space, spaces.Box) and steps is not None and factor is not None:
        return Image(path, space, tuple(steps), factor)
    if _children(space):
        leaves = _leaves(space, "".join(f"{key}/" for key in path))
        hint = f"Give the keys on the way to the image, one of {', '.join(leaves)}."
    elif len(shape) < 2 or (len(shape) == 2 and factor is None):
        hint = _STATE
    else:
        hint = _STACKED if steps is None else _RESCALE
    raise ValueError(f"{_where(path)} must be an RGB image, Box(0, 255, (H, W, 3), uint8), got {space}. {hint}")


def _factor(space: spaces.Box) -> float | None:
    """Return what makes 0...255 of an image's values, 0 if they are uint8 already; None if their range is unknown."""
    high = float(space.high.max(initial=0))
    if space.dtype == np.uint8:
        return 0.0 if high > 1 else None
    if (space.low < 0).any() or high not in (1, _FULL) or (space.high < high).any():  # or depth is the fourth channel
        return None
    return _FULL / high if np.issubdtype(space.dtype, np.floating) else 1.0 if high > 1 else None


def _depth(path: Path, space: Any, size: tuple[int, int]) -> Image:
    """Return the depth image of a space.

    Raises:
        ValueError: It is none, or not as large as the colour image.
    """
    steps = steps_to_depth(space.shape) if isinstance(space, spaces.Box) else None
    if steps is not None and is_depth(space.dtype):
        image = Image(path, space, tuple(steps))
        if image.size == size:
            return image
    raise ValueError(
        f"{_where(path)} must be a depth image as large as the RGB image, Box(..., {size}, uint16 or int16) in "
        f"millimetres or of floats in metres, got {space}. Pass depth_key= if it has another key."
    )
