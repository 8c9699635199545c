"""Why a pixel rule finds next to nothing, and depth or clouds in a wrong unit: hints for the person at the camera."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.frame import FARTHEST, MILLIMETRE, Frame
from shape_obs.geometry.observed import MIN_SAMPLES
from shape_obs.image.region import Region
from shape_obs.image.roi import ROI, Window
from shape_obs.image.segmentation import (
    HUES,
    LEVELS,
    ColourRule,
    DepthRange,
    GrayRange,
    HSVRange,
    Segmentation,
    across_red,
    rescaled_hues,
)

_EVERY: Final = 30  # frames between two looks at a rule: one takes some milliseconds
_ENOUGH: Final = 4  # times the smallest object, and times what matches: so many pixels are worth a hint
_MOST: Final = 0.5  # of the image: more are not the object
_MORE_RED: Final = 1.3  # times as many pixels with both sides of hue 0: a part of the object is missing
_PERCENT: Final = 100
_PICK: Final = "`shape-obs detect IMAGE --pick u,v` proposes a segmentation from a pixel on the object"

_NEAR, _FAR = 0.05, 20.0  # metres: an object lies nearer or farther only if the unit is wrong
_LEAST, _LARGEST = 0.005, 20.0  # metres: the same of the size of a cloud
_TRIES: Final = 30  # frames whose mask has no depth at all, after which it is looked at no more
_SOME: Final = 2000  # values whose median is taken
#: What the numbers of floating depth may be instead of metres, and what makes metres of them.
_FLOATING: Final = (
    ("millimetres", 1e-3, "give depth / 1000, or the camera's uint16 image as it is"),
    ("centimetres", 1e-2, "give depth / 100"),
    ("tenths of a millimetre", 1e-4, "give depth / 10000"),
    ("metres divided by 1000, as of millimetres that were converted twice", 1e3, "give depth * 1000"),
)
#: What the numbers of uint16 depth may be instead of millimetres, and what makes metres of them as they were read.
_WHOLE: Final = (
    ("tenths of a millimetre", 1e-1, "give depth // 10, or depth * 1e-4 as float32 metres"),
    ("centimetres", 1e1, "give depth * 10"),
    ("metres", 1e3, "give depth.astype(np.float32)"),
)


class MaskHints:
    """Explain masks without an object, at most once in 30 frames for each rule, and find the missing part of a red one.

    Args:
        rules: The rules.

    Attributes:
        reds: Those of reds on one side of hue 0 whose object was not looked at yet, with those of both sides.
    """

    def __init__(self, rules: Iterable[Segmentation | None]) -> None:
        self._known: dict[Segmentation, tuple[int, str]] = {}
        reds = [rule for rule in rules if isinstance(rule, HSVRange)]
        self.reds = {rule: around for rule in reds if (around := across_red(rule)) is not None}

    def look_at_red(self, rule: Segmentation | None, frame: Frame) -> None:
        """Warn once if what a rule of reds found goes on with hues on the other side of 0.

        Args:
            rule: The rule, which found an object.
            frame: The images.
        """
        if not isinstance(rule, HSVRange) or (around := self.reds.pop(rule, None)) is None or frame.rgb is None:
            return
        found = rule.matches(frame.rgb) > 0
        labels, stats = map(np.asarray, cv2.connectedComponentsWithStats(around.matches(frame.rgb))[1:3])
        touched: Any = np.unique(labels[found])  # the background is 0, and not among these
        count, whole = np.count_nonzero(found), int(stats[touched, cv2.CC_STAT_AREA].sum())
        if whole > _MORE_RED * count:
            warnings.warn(
                f"{rule.label}: {count} pixels of the object match, {whole} would with a hue that wraps around: "
                f"{_red(around)}.",
                stacklevel=5,
            )

    def explained(
        self,
        region: Region,
        rule: Segmentation,
        frame: Frame,
        mask: npt.NDArray[np.uint8] | None,
        roi: ROI,
        number: int,
    ) -> Region:
        """Return a region whose refusal also says what was seen.

        Args:
            region: The region, which was refused because it has too few pixels.
            rule: The rule that found it.
            frame: The images.
            mask: ``(H, W)`` the mask of a rule that reads the whole image; None for others.
            roi: The part of the image that was searched.
            number: Of the frame; between two looks the last explanation is repeated.
        """
        last = self._known.get(rule)
        if last is None or number - last[0] >= _EVERY:
            self._known[rule] = last = number, why_empty(rule, frame, mask, roi)
        return replace(region, refusal=f"{region.refusal}: {last[1]}")


def why_empty(rule: Segmentation, frame: Frame, mask: npt.NDArray[np.uint8] | None, roi: ROI) -> str:
    """Return how many pixels match a rule that finds no object, and what would match, in words."""
    assert frame.size is not None
    height, width = frame.size
    whole, window = Window(0, 0, width, height), roi.window(frame.size)
    if mask is None:
        own = type(rule).apply is not Segmentation.apply
        mask = rule.apply(frame, whole) if own else rule.threshold(frame, whole)
    inside = cv2.countNonZero(_within(mask, roi, window))
    outside = np.count_nonzero(mask) - inside
    narrow = window != whole or type(roi).blank is not ROI.blank
    parts = [f"{inside} of {window.width * window.height} pixels match {rule.label}"]
    if inside >= MIN_SAMPLES:
        opened = f"open={rule.open} removes or which " if rule.open > 1 else ""
        parts[0] += f", which {opened}lie in pieces of fewer than {rule.min_area} pixels (min_area)"
    if narrow and outside >= _ENOUGH * max(rule.min_area, MIN_SAMPLES):
        parts.append(f"{outside} pixels outside the region of interest match")
    for text, other, image in _variants(rule, frame.rgb):
        count = cv2.countNonZero(_within(other.matches(image), roi, window))
        enough = _ENOUGH * max(rule.min_area, MIN_SAMPLES, inside)
        if enough <= count <= _MOST * window.width * window.height:
            parts.append(text.format(count))
    if isinstance(rule, (HSVRange, GrayRange)) and max(np.atleast_1d(rule.high)[-2:]) <= 1:
        what = "s and v are" if isinstance(rule, HSVRange) else "gray is"
        parts.append(f"its bounds look like 0...1, but {what} 0...255")
    if isinstance(rule, HSVRange) and frame.rgb is not None and bool((frame.rgb == frame.rgb[..., :1]).all()):
        parts.append("the image is gray, without hues; give GrayRange")
    if isinstance(rule, DepthRange) and frame.depth is not None:
        parts.append(_depths(frame.depth[window.slices]))
    if isinstance(rule, ColourRule):
        parts.append(_PICK)
    return "; ".join(parts)


def _within(mask: npt.NDArray[Any], roi: ROI, window: Window) -> npt.NDArray[np.uint8]:
    return roi.blank(np.not_equal(mask[window.slices], 0).view(np.uint8), window)


def _variants(rule: Segmentation, rgb: npt.NDArray[np.uint8] | None) -> Iterator[tuple[str, ColourRule, Any]]:
    """Yield what a user may have meant: a hint with room for the count, the rule, and the image."""
    if rgb is None or not isinstance(rule, ColourRule):
        return
    yield (
        "with red and blue swapped {} would: give RGB, not BGR as OpenCV reads it (cv2.cvtColor(image, "
        "cv2.COLOR_BGR2RGB))",
        rule,
        np.ascontiguousarray(rgb[..., ::-1]),
    )
    if isinstance(rule, HSVRange):
        text = "with {what} {{}} would: OpenCV's scale is h 0...179, s and v 0...255; give low={low}, high={high}"
        half = rescaled_hues(rule, 2 * HUES)
        meant = [("half the hue", half), ("the hue times 180 / 256", rescaled_hues(rule, LEVELS))]
        if max(*rule.low[1:], *rule.high[1:]) <= _PERCENT:
            low, high = (
                (bound[0], *(round(255 / _PERCENT * value) for value in bound[1:])) for bound in (half.low, half.high)
            )
            meant.insert(1, ("half the hue, and s and v in percent,", replace(half, low=low, high=high)))
        for what, other in meant:
            yield text.format(what=what, low=other.low, high=other.high), other, rgb
        if (around := across_red(rule)) is not None:
            yield f"with a hue that wraps around {{}} would: {_red(around)}", around, rgb


def _red(rule: HSVRange) -> str:
    return f"red lies on both sides of hue 0; give low={rule.low}, high={rule.high}"


def _depths(depth: npt.NDArray[Any]) -> str:
    """Return where the valid depth of an image lies, in words."""
    middle = middle_depth(depth.ravel())
    if middle is None:
        return "no pixel has a valid depth"
    return f"half of the valid depth is below {middle:.3g} m{depth_problem(middle, depth.dtype)}"


class UnitCheck:
    """Warn once if depth or a cloud puts the object where no object is.

    Only the first frame with depth under the mask is looked at, and the first one after each reset.

    Attributes:
        pending: Whether the next frame is to be looked at.
    """

    def __init__(self) -> None:
        self.pending, self._warned, self._tries = True, False, 0

    def reset(self) -> None:
        """Look at the next frame, unless there was a warning already."""
        self.pending, self._tries = not self._warned, 0

    def look_at_depth(self, regions: Iterable[Region], depth: npt.NDArray[Any]) -> None:
        """Warn if the depth under a mask is below 5 cm or above 20 m.

        Args:
            regions: The masks of one frame.
            depth: ``(H, W)`` as a frame holds it.
        """
        for region in regions:
            if not region.areas:
                continue
            rows, first, past = region.runs.T
            distance = middle_depth(depth[rows, (first + past) // 2])  # in the middle of each run of pixels
            if distance is not None:
                self.pending = False
                if problem := depth_problem(distance, depth.dtype):
                    self._warn(f"depth: the object is {distance:.3g} m away{problem}.", 5)
                return
            self._tries += 1
            self.pending = self._tries < _TRIES

    def look_at_cloud(self, points: npt.NDArray[np.floating[Any]]) -> None:
        """Warn if a cloud is smaller than 5 mm or larger than 20 m.

        Args:
            points: ``(M, 3)`` metres, finite.
        """
        if not len(points):
            return
        self.pending = False
        low, high = np.percentile(points[:: -(-len(points) // _SOME)], (5, 95), axis=0)
        size = float(np.max(high - low))
        if size > _LARGEST:
            text = f"cloud: the object is {size:.3g} m large. Are the points in millimetres? Give points / 1000."
            self._warn(text, 4)
        elif 0 < size < _LEAST:
            self._warn(
                f"cloud: the object is {size * 1e3:.3g} mm large. Were metres divided by 1000, as millimetres that "
                "are converted twice? Give points * 1000.",
                4,
            )

    def _warn(self, text: str, level: int) -> None:
        self._warned = True
        warnings.warn(f"{text} This warning is shown once.", stacklevel=level)


def middle_depth(values: npt.NDArray[Any]) -> float | None:
    """Return the median of depth values in metres; None if none is valid.

    Args:
        values: ``(M,)`` uint16 millimetres or floating metres; 0, negative, non-finite and absurd are invalid.
    """
    valid = values[(values > 0) & (values < FARTHEST)]
    if not len(valid):
        return None
    middle = float(np.median(valid[:: -(-len(valid) // _SOME)]))
    return middle * MILLIMETRE if values.dtype.kind == "u" else middle


def depth_problem(distance: float, dtype: np.dtype[Any]) -> str:
    """Return what is likely wrong with depth that puts an object at a distance; empty if it is plausible.

    Args:
        distance: In metres, as the depth was read.
        dtype: Of the depth: uint16 or floating.
    """
    if _NEAR <= distance <= _FAR:
        return ""
    whole = dtype.kind == "u"
    read = "uint16 depth is read as millimetres" if whole else "floating depth is read as metres"
    for unit, factor, advice in _WHOLE if whole else _FLOATING:
        if _NEAR <= distance * factor <= _FAR:
            return f": {read}, but these look like {unit}; {advice}"
    return f": {read}; check the unit"
