"""Pixel rules: which pixels belong to the object, by hue, saturation and value, by brightness, or by depth.

All rules share a clean-up by opening and closing, and the area threshold. Those that look at the colour of one pixel
at a time compile to a table.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, ClassVar, Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.frame import MILLIMETRE, Frame
from shape_obs.image.mask_check import checked_mask
from shape_obs.image.roi import Window
from shape_obs.spec import Spec, SpecError
from shape_obs.utils.lengths import warn_unless_metres

if TYPE_CHECKING:
    from typing_extensions import Self

Table = npt.NDArray[np.uint64]

LEVELS: Final = 256  # of a colour channel
_KEPT: Final = 16  # tables, 2 MB each
#: Kinds that other modules define.
_ELSEWHERE: Final = {
    "callable": "shape_obs.image.mask_function",
    "click": "shape_obs.image.clicked_colours",
    "click_net": "shape_obs.clicks",
}


@dataclass(frozen=True, kw_only=True)
class Segmentation(Spec, family="segmentation", modules=_ELSEWHERE):
    """A pixel rule with its clean-up.

    A subclass whose ``whole_image`` is True has its ``threshold`` called once for each frame with a window of the whole
    image, for example because a neural network reads it; otherwise it is called with each window that is searched.

    Args:
        open: Edge of the square for morphological opening, pixels; 0 leaves it out. An object thinner than this
            vanishes.
        close: Edge of the square for morphological closing, pixels; 0 leaves it out. A gap narrower than this fills.
        min_area: Components with fewer pixels are dropped.
        min_share: Components smaller than this share of the largest are dropped; 1 keeps the largest alone, as the
            paper does. A cable that something crosses falls into several components, hence the default.
    """

    whole_image: ClassVar[bool] = False

    open: int = 0
    close: int = 0
    min_area: int = 20
    min_share: float = 0.05

    @classmethod
    def from_dict(cls, value: Any) -> Self:
        """Build a rule as ``Spec.from_dict`` does; a function or its path ``"module:function"`` is one of its own.

        Raises:
            SpecError: A field or kind is unknown, or a value has a wrong type.
        """
        path = isinstance(value, str) and ":" in value
        if path or (callable(value) and not isinstance(value, (Segmentation, type))):
            value = {"kind": "callable", "function": value}
        return super().from_dict(value)  # type: ignore[arg-type]

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.open < 0 or self.close < 0 or self.min_area < 1:
            raise ValueError(
                f"{self.kind}: open and close must be >= 0 and min_area >= 1, "
                f"got {self.open}, {self.close} and {self.min_area}."
            )
        if not 0 <= self.min_share <= 1:
            raise ValueError(f"{self.kind}: min_share must lie in 0...1, got {self.min_share}.")

    def apply(self, frame: Frame, window: Window) -> npt.NDArray[np.uint8]:
        """Return the mask of ``window``: ``(h, w)`` uint8, 0 = background, after opening and closing."""
        return self.clean(checked_mask(self.threshold(frame, window), (window.height, window.width), self.label))

    def clean(self, mask: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """Return a mask after opening and closing; it is overwritten."""
        for size, operation in ((self.open, cv2.MORPH_OPEN), (self.close, cv2.MORPH_CLOSE)):
            if size > 1:
                square = cv2.getStructuringElement(cv2.MORPH_RECT, (size, size))
                cv2.morphologyEx(mask, operation, square, dst=mask)
        return mask

    @abstractmethod
    def threshold(self, frame: Frame, window: Window) -> npt.NDArray[Any]:
        """Return the mask of the bare rule: ``(h, w)`` bool or uint8, 0 and 1 or 0 and 255."""

    @property
    def label(self) -> str:
        """What error messages call the rule."""
        own = type(self)
        return f"segmentation {self.kind!r}" if "kind" in vars(own) else f"segmentation {own.__name__}"

    @property
    def code_path(self) -> str:
        """The import path of the user's code that the rule names; empty if it names none."""
        return ""

    def prepare(self) -> None:
        """Load what the rule needs before the first frame; most need nothing."""


def need(image: npt.NDArray[Any] | None, name: str, rule: Segmentation) -> npt.NDArray[Any]:
    """Return the image that a rule reads, or an error that says which is missing."""
    if image is None:
        raise ValueError(f"{rule.label} needs {name}, but the frame has none.")
    return image


class ColourRule(Segmentation):
    """A pixel rule for which the colour of a pixel alone decides, not its place, its neighbours or the frame.

    Such a rule is compiled to a table of all colours, once, and looked up from then on where that is faster: see
    ``colour_table``. The result is the same to the pixel.

    Example:
        >>> @dataclass(frozen=True)
        ... class MostlyRed(ColourRule, kind="mostly_red"):
        ...     lead: int = 40
        ...
        ...     def matches(self, rgb):
        ...         red, green, blue = np.moveaxis(rgb.astype(int), -1, 0)
        ...         return red - np.maximum(green, blue) >= self.lead
    """

    @abstractmethod
    def matches(self, rgb: npt.NDArray[np.uint8]) -> npt.NDArray[Any]:
        """Return which pixels of an ``(h, w, 3)`` image belong to the object: ``(h, w)``, as ``threshold`` does."""

    def threshold(self, frame: Frame, window: Window) -> npt.NDArray[np.uint8]:
        """Return the mask of the window: ``(h, w)`` uint8, 0 or 255."""
        found = self.matches(need(frame.rgb, "rgb", self)[window.slices])
        mask = checked_mask(found, (window.height, window.width), self.label)
        return mask if mask is found else mask * np.uint8(255)


class Expected(NamedTuple):
    """Where an object is expected in a frame.

    Args:
        places: ``(N, 2)`` pixels in it, of the frame before and as predicted; not all of them are right.
        mask: ``(H, W)`` uint8, 0 or 1, about where its pixels should be.
        ropes: Whether it is a rope, or several, and not a sheet or ring.
        anywhere: Whether pieces of it may be elsewhere: some were hidden, or it is time to look again.
    """

    places: npt.NDArray[np.float64]
    mask: npt.NDArray[np.uint8]
    ropes: bool
    anywhere: bool


class FollowingRule(Segmentation):
    """A pixel rule that looks where the track expects the object."""

    def apply_near(self, frame: Frame, window: Window, expected: Expected) -> npt.NDArray[np.uint8]:
        """Return what ``apply`` returns, of an object that is expected somewhere."""
        mask = self.threshold_near(frame, window, expected)
        return self.clean(checked_mask(mask, (window.height, window.width), self.label))

    @abstractmethod
    def threshold_near(self, frame: Frame, window: Window, expected: Expected) -> npt.NDArray[Any]:
        """Return what ``threshold`` returns, of an object that is expected somewhere."""


HUES = 180
_RED: Final = 10  # the hues on both sides of 0 that are red
_WIDEST_RED: Final = 40  # hues; a wider range is not meant to be red alone


@dataclass(frozen=True)
class HSVRange(ColourRule, kind="hsv"):
    """Pixels whose colour lies in a box of HSV space, bounds included.

    Args:
        low: (h, s, v), OpenCV's scale: h 0...179, s and v 0...255.
        high: (h, s, v). A hue below ``low``'s wraps around: red is ``low=(170, ...)``, ``high=(10, ...)``. The 180 of
            OpenCV's tutorials becomes 179.
    """

    low: tuple[int, int, int]
    high: tuple[int, int, int]

    def __post_init__(self) -> None:
        top = (HUES - 1, 255, 255)
        for name, bound in (("low", self.low), ("high", self.high)):
            if scaled := _from_fractions(bound):
                raise SpecError(
                    f"hsv: {name} must be (h 0...179, s 0...255, v 0...255), got {tuple(bound)}. If that is 0...1, "
                    f"give {scaled}."
                )
        super().__post_init__()
        if self.high[0] == HUES:
            object.__setattr__(self, "high", (HUES - 1, *self.high[1:]))
        for name, bound in (("low", self.low), ("high", self.high)):
            if len(bound) != 3 or any(not 0 <= value <= limit for value, limit in zip(bound, top, strict=True)):
                text = f"hsv: {name} must be (h 0...179, s 0...255, v 0...255), got {bound}."
                raise ValueError(text + _hue_hint(bound[0], name == "high", self.high[0] - self.low[0]))
        for i, name in ((1, "saturation"), (2, "value")):
            if self.low[i] > self.high[i]:
                raise ValueError(
                    f"hsv: low {name} {self.low[i]} is above high {name} {self.high[i]}; only hue wraps around."
                )

    def matches(self, rgb: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """Return the mask of an image: ``(h, w, 3)`` uint8 -> ``(h, w)`` uint8, 0 or 255."""
        hsv = cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV)
        if self.low[0] <= self.high[0]:
            return _in_range(hsv, self.low, self.high)
        mask = _in_range(hsv, self.low, (HUES - 1, *self.high[1:]))
        return mask | _in_range(hsv, (0, *self.low[1:]), self.high)


def _from_fractions(bound: Any) -> tuple[int, ...] | None:
    """Return a colour given as 0...1 on OpenCV's scale; None if it has no fractions, or more than fractions."""
    values = list(bound) if isinstance(bound, (tuple, list, np.ndarray)) else []
    numbers = len(values) == 3 and all(isinstance(value, (int, float)) and 0 <= value <= 1 for value in values)
    if not numbers or all(float(value).is_integer() for value in values):
        return None
    return tuple(round(value * scale) for value, scale in zip(values, (HUES - 1, 255, 255), strict=True))


def _hue_hint(hue: int, upper: bool, width: int) -> str:
    """Return what may be meant by a hue outside 0...179, as the end of an error message; width is the range's."""
    meant = ["0, which is the same hue"] if hue == HUES else []
    if 0 <= width <= _WIDEST_RED and (hue < 0 or (upper and hue - width < HUES < hue)):
        low, high = ((hue - width) % HUES, hue % HUES) if upper else (hue % HUES, (hue + width) % HUES)
        meant = [f"{hue % HUES} if it wraps around: low {low} and high {high} are {low}...{HUES - 1} and 0...{high}"]
    meant += [f"{HUES - 1} for no upper limit"] if upper and hue in (LEVELS - 1, 2 * HUES) else []
    meant += [f"{_rescaled(hue, LEVELS)} if it is 0...255"] if HUES <= hue < LEVELS else []
    meant += [f"{_rescaled(hue, 2 * HUES)} if it is in degrees"] if HUES <= hue <= 2 * HUES else []
    return f" Of the hue give {', or '.join(meant)}." if meant else ""


def _rescaled(hue: int, hues: int) -> int:
    """Return a hue on a scale of so many hues on OpenCV's scale."""
    return min(hue * HUES // hues, HUES - 1)


def rescaled_hues(rule: HSVRange, hues: int) -> HSVRange:
    """Return a range whose hues were on a scale of so many hues."""
    low, high = ((_rescaled(bound[0], hues), *bound[1:]) for bound in (rule.low, rule.high))
    return replace(rule, low=low, high=high)


def across_red(rule: HSVRange) -> HSVRange | None:
    """Return a range of reds that ends at hue 0 or 179 as one that wraps around; None for other colours."""
    low, high = rule.low[0], rule.high[0]
    if low > high or high - low >= _WIDEST_RED:
        return None
    if low <= _RED:
        return replace(rule, low=(HUES - _RED, *rule.low[1:]))
    return replace(rule, high=(_RED, *rule.high[1:])) if high >= HUES - 1 - _RED else None


def _in_range(hsv: npt.NDArray[Any], low: tuple[int, int, int], high: tuple[int, int, int]) -> npt.NDArray[np.uint8]:
    return np.asarray(cv2.inRange(hsv, np.array(low, np.uint8), np.array(high, np.uint8)), dtype=np.uint8)


@dataclass(frozen=True)
class GrayRange(ColourRule, kind="gray"):
    """Pixels whose luma (ITU-R BT.601) lies in a range, bounds included.

    Args:
        low: Darkest, 0...255.
        high: Brightest, 0...255.
    """

    low: int = 0
    high: int = 255

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.low <= self.high <= 255:
            raise ValueError(f"gray: expected 0 <= low <= high <= 255, got low {self.low} and high {self.high}.")

    def matches(self, rgb: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """Return the mask of an image: ``(h, w, 3)`` uint8 -> ``(h, w)`` uint8, 0 or 255."""
        gray = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
        return np.asarray(cv2.inRange(gray, np.array([self.low]), np.array([self.high])), dtype=np.uint8)


@dataclass(frozen=True)
class DepthRange(Segmentation, kind="depth"):
    """Pixels whose depth lies in a range, bounds included; invalid depth never does.

    Args:
        near: Metres along the optical axis.
        far: Metres along the optical axis.
    """

    near: float
    far: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.near <= self.far or not np.isfinite(self.far):
            raise ValueError(f"depth: expected 0 < near <= far in metres, got near {self.near} and far {self.far}.")
        warn_unless_metres("depth: near", self.near, stacklevel=4)

    def threshold(self, frame: Frame, window: Window) -> npt.NDArray[np.uint8]:
        """Return the mask of the window: ``(h, w)`` uint8, 0 or 255."""
        depth = need(frame.depth, "depth", self)[window.slices]
        if depth.dtype == np.uint16:
            low, high = max(np.ceil(self.near / MILLIMETRE - 1e-6), 1), np.floor(self.far / MILLIMETRE + 1e-6)
            inside = (depth >= low) & (depth <= high)
        else:
            inside = (depth >= self.near) & (depth <= self.far)
        return np.asarray(inside).view(np.uint8) * np.uint8(255)


@lru_cache(maxsize=_KEPT)
def colour_table(rule: ColourRule) -> Table:
    """Compile a rule to a table over all colours, a bit each, in some 40 ms; equal rules share one table.

    It is the rule itself, not an approximation. A table of 32 x 32 x 32 bins would fit the nearest cache, but a bin
    that the border of a rule cuts through turns whole areas of one colour over, and drawn images have such areas. Two
    megabytes are looked up as fast: an object's colours lie close together, so few of them are ever touched.

    Returns:
        (262144,) uint64, read-only: the colour (r, g, b) is bit ``b & 63`` of word ``r << 10 | g << 2 | b >> 6``.

    Raises:
        TypeError: The rule returned no mask.
        ValueError: It returned a mask of another size, or of other values.
    """
    levels = np.arange(LEVELS, dtype=np.uint8)
    plane = np.empty((LEVELS, LEVELS, 3), np.uint8)
    plane[..., 1], plane[..., 2] = levels[:, None], levels
    table = np.empty((LEVELS, LEVELS * LEVELS // 8), np.uint8)
    for red in range(LEVELS):
        plane[..., 0] = red
        found = checked_mask(rule.matches(plane), (LEVELS, LEVELS), rule.label)
        table[red] = np.packbits(found != 0, bitorder="little")
    words = table.reshape(-1).view("<u8").astype(np.uint64, copy=False)
    words.setflags(write=False)
    return words
