"""From a frame to the region of a pixel rule, the quickest way that gives the same pixels."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import Any, TypeGuard

import numpy as np
import numpy.typing as npt

from shape_obs.frame import Frame
from shape_obs.geometry.observed import MIN_SAMPLES
from shape_obs.image.colour_search import find_on_lattice, flat_pixels, look_up
from shape_obs.image.connected_runs import draw_components, find_components, near_mask
from shape_obs.image.mask_check import checked_mask
from shape_obs.image.outline_tracing import trace_components
from shape_obs.image.region import Region
from shape_obs.image.roi import ROI, Window
from shape_obs.image.segmentation import ColourRule, Expected, FollowingRule, Segmentation, colour_table, need

# A strand at least so wide, pixels, is not missed where one pixel in step x step is looked at: see ``find_on_lattice``.
_WIDE, _FAR_STEP, _NARROW, _NEAR_STEP = 12.0, 8, 7.0, 4

# An object has a run of pixels in each of its rows and columns, and a few more where it bends, branches or has
# holes; a checkerboard has one for every two pixels, noise one for every four, a thin line that fills the image one for
# every few along rows or columns. A mask with more than this is not measured, so that no frame takes long.
_PIXELS_PER_RUN, _MOST_RUNS = 16, 4096


def segment(
    frame: Frame,
    window: Window,
    rule: Segmentation,
    roi: ROI,
    width: float = 0.0,
    expected: Expected | None = None,
) -> Region:
    """Find the plausible components of a rule's mask in a window, the quickest way that gives the same pixels.

    A colour rule is looked up in its table. If the object is known to be wide, not every pixel has to be read:
    components that hold no disc nearly as wide may then be overlooked, and all others are the same to the pixel.

    Args:
        frame: The images.
        window: Where to look.
        rule: Which pixels belong to the object.
        roi: What to blank in the window.
        width: Of the object where it is thinnest, pixels; 0 if it is unknown, and nothing is overlooked.
        expected: Where a rule that follows the object should look for it; None for everywhere.
    """
    if isinstance(rule, FollowingRule) and expected is not None:
        mask = rule.apply_near(frame, window, expected)
    elif not is_tabulated(rule):
        mask = rule.apply(frame, window)
        if type(rule).apply is not Segmentation.apply:  # which checks what ``threshold`` returns
            mask = checked_mask(mask, (window.height, window.width), rule.label)
    else:
        pixels = flat_pixels(frame.rgb if frame.rgb is not None else need(None, "rgb", rule), window)
        table, step = colour_table(rule), _FAR_STEP if width >= _WIDE else _NEAR_STEP if width >= _NARROW else 1
        untouched = max(rule.open, rule.close) <= 1 and type(roi).blank is ROI.blank
        if step > 1 and untouched:
            return _region(window, *find_on_lattice(*pixels, window[:4], table, step, rule.min_area, rule.min_share))
        mask = rule.clean(look_up(*pixels, window[:4], table))
    return find_region(roi.blank(mask, window), window, rule.min_area, rule.min_share)


def cut_region(mask: npt.NDArray[np.uint8], window: Window, rule: Segmentation, roi: ROI) -> Region:
    """Find the plausible components in a window of the mask that a rule returned for the whole image.

    Args:
        mask: ``(H, W)`` uint8, 0 = background; it stays as it is.
        window: Where to look.
        rule: The clean-up.
        roi: What to blank in the window.
    """
    part = rule.clean(mask[window.slices].copy())
    return find_region(roi.blank(part, window), window, rule.min_area, rule.min_share)


def find_region(mask: npt.NDArray[np.uint8], window: Window, min_area: int, min_share: float) -> Region:
    """Keep the plausible components of a mask.

    Args:
        mask: ``(h, w)`` uint8, 0 = background.
        window: Where the mask lies in the image.
        min_area: Smaller components are dropped, pixels.
        min_share: So are those smaller than this share of the largest.

    Returns:
        The region; without components when nothing is left.
    """
    if mask.dtype != np.uint8:
        mask = (mask != 0).view(np.uint8)
    if not (mask.flags.c_contiguous and mask.flags.writeable):
        mask = mask.copy()  # compiled code distinguishes such arrays
    return _region(window, *find_components(mask, window.left, window.top, 1, min_area, min_share))


def region_of_runs(runs: npt.NDArray[np.int64], within: Window, min_area: int, min_share: float) -> Region:
    """Keep the plausible components of runs of pixels.

    Args:
        runs: ``(R, 3)``, see ``connected_runs``.
        within: The part of the image that they lie in; the region's window is as small as they are.
        min_area: Smaller components are dropped, pixels.
        min_share: So are those smaller than this share of the largest.
    """
    left, top, wide, high = within
    found, (left, top) = draw_components(runs, left, top, left + wide, top + high, min_area, min_share)
    return _region(Window(left, top, found[0].shape[1], found[0].shape[0]), *found)


def _region(
    window: Window,
    mask: npt.NDArray[np.uint8],
    runs: npt.NDArray[np.int64],
    areas: npt.NDArray[np.int64],
    box: tuple[int, int, int, int],
    column_runs: int,
) -> Region:
    refusal, most = "", max(_MOST_RUNS, mask.size // _PIXELS_PER_RUN)
    if (count := max(len(runs), column_runs)) > most:
        refusal = (
            f"the mask has {count} runs of pixels, at most {most}: it is noise or a fine pattern, no object; "
            "check the segmentation"
        )
        mask, runs, areas, box = np.zeros_like(mask), runs[:0], areas[:0], (window.left, window.top, 0, 0)
    sizes = sorted(areas.tolist(), reverse=True)
    area, noise = sum(sizes), bool(refusal)
    if area < MIN_SAMPLES and not refusal:
        refusal = f"the mask has {area} pixels, at least {MIN_SAMPLES} are needed" if area else "the mask is empty"
    return Region(window, mask, runs, tuple(sizes), Window(*box), area, len(sizes), refusal, noise=noise)


@lru_cache(maxsize=64)
def is_tabulated(rule: Segmentation | None) -> TypeGuard[ColourRule]:
    """Return whether a table gives what a rule gives: a colour rule that overrides nothing but ``matches``."""
    return (
        isinstance(rule, ColourRule)
        and type(rule).threshold is ColourRule.threshold
        and type(rule).apply is ColourRule.apply
        and type(rule).clean is ColourRule.clean
    )


def prepare(rules: Iterable[Segmentation | None]) -> list[Callable[..., Any]]:
    """Build the tables of colour rules, prepare the others, and return the compiled functions that any region needs."""
    tabulated = []
    for rule in rules:
        if isinstance(rule, ColourRule) and is_tabulated(rule):
            tabulated.append(colour_table(rule))
        elif rule is not None:
            rule.prepare()
    colours = [look_up, find_on_lattice] if tabulated else []
    return [find_components, near_mask, trace_components, *colours]
