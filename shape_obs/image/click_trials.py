"""Rules that clicks on a photo may mean, and how well each separates an object from what is around it.

A click may mean a wire, the bundle it runs in or the table; so several regions around it are tried. For each one a
mixture of colours is fitted to it and another one to all else (as in GrabCut: Rother, Kolmogorov and Blake, 2004, but
without a smoothness term, which would cut thin wires off). The best rule finds something with a border that stands out
against the variation within.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.image.click_regions import (
    Mask,
    Photo,
    Pixel,
    around,
    border_changes,
    box,
    core,
    regions_at,
)  # fmt: skip
from shape_obs.image.clicked_colours import ClickedColours, ColourGaussian, fit_colours, log_odds

_REGIONS: Final = 4  # regions around a click that are tried
_NEAR: Final = 25  # pixels around an object that count as its surroundings
_OBJECT_SAMPLES, _GROUND_SAMPLES, _OTHER_SAMPLES = 800, 1400, 500
_OBJECT_COLOURS, _GROUND_COLOURS, _OTHER_COLOURS = 3, 5, 3
_VARIATION: Final = 5.0  # of the colours of an object, in Lab; less counts as so much
_OF_LIGHT: Final = 0.35  # weight of variation of lightness
_SMALLEST: Final = 10  # pixels
_SQUARE: Final = np.ones((3, 3), np.uint8)
INSIDE: Final = 8  # of the 3 x 3 pixels around a click: it lies in a mask, not on its border


@dataclass(frozen=True, eq=False)
class Trial:
    """A rule, and what it finds in the photo.

    Attributes:
        rule: The rule.
        odds: Of each cell of the photo, see ``log_odds``.
        found: ``(H, W)`` bool, all plausible pieces.
        clicked: ``(H, W)`` bool, the pieces at the clicks.
        score: How clearly it stands out, 0 or more; only to compare.
    """

    rule: ClickedColours
    odds: npt.NDArray[np.float64]
    found: Mask
    clicked: Mask
    score: float


def trials(photo: Photo, picks: list[Pixel], nots: list[Pixel]) -> Iterator[Trial]:
    """Yield rules for the regions that the clicks may mean."""
    regions = [
        [region for region in regions_at(photo, pick) if not any(around(region.mask, no) >= INSIDE for no in nots)]
        for pick in picks
    ]
    likely = [found[0].mask for found in regions if found]
    off = _elsewhere(photo, picks, nots, likely)
    choices = [
        [region.mask for region in found[:_REGIONS]] or [_disc(photo, pick)]
        for found, pick in zip(regions, picks, strict=True)
    ]
    plans = [[masks[min(k, len(masks) - 1)] for masks in choices] for k in range(_REGIONS)]
    plans += [[masks[0]] for masks in choices if len(choices) > 1]
    tried: list[Mask] = []
    for parts in plans:
        whole = np.logical_or.reduce(parts)
        if any(np.array_equal(whole, other) for other in tried):
            continue
        tried.append(whole)
        first = _trial(photo, parts, [off], picks, nots)
        if first is None:
            continue
        yield first
        grown = first.clicked & ~off
        if np.count_nonzero(grown ^ whole) > 0.1 * np.count_nonzero(whole):
            more = _trial(photo, [grown], [off], picks, nots)
            if more is not None:
                yield more
        # What the rule found elsewhere may be another object of a similar colour.
        stray = first.found & ~np.asarray(cv2.dilate(whole.view(np.uint8), _SQUARE, iterations=3)).view(np.bool_) & ~off
        for u, v in picks:
            stray[max(v - 3, 0) : v + 4, max(u - 3, 0) : u + 4] = False
        if np.count_nonzero(stray) > 0.1 * np.count_nonzero(whole):
            less = _trial(photo, parts, [off, stray], picks, nots)
            if less is not None:
                yield less


def _elsewhere(photo: Photo, picks: list[Pixel], nots: list[Pixel], likely: list[Mask]) -> Mask:
    """Return the regions around clicks that are not on the object, without what the clicks on it mean."""
    off = np.zeros(photo.shape, np.bool_)
    for no in nots:
        outside = all(around(mask, no) < INSIDE for mask in likely)
        for region in regions_at(photo, no) if outside else ():
            meant = any(around(region.mask, pick) for pick in picks)
            shared = [np.count_nonzero(region.mask & mask) for mask in likely]
            sizes = [min(np.count_nonzero(region.mask), np.count_nonzero(mask)) for mask in likely]
            if not meant and all(part < 0.1 * size for part, size in zip(shared, sizes, strict=True)):
                off |= region.mask
                break
        off |= _disc(photo, no) & ~np.logical_or.reduce([np.zeros_like(off), *(likely if outside else ())])
    return off


def _disc(photo: Photo, pixel: Pixel) -> Mask:
    u, v = pixel
    mask = np.zeros(photo.shape, np.bool_)
    mask[max(v - 1, 0) : v + 2, max(u - 1, 0) : u + 2] = True
    return mask


def _trial(photo: Photo, parts: list[Mask], others: list[Mask], picks: list[Pixel], nots: list[Pixel]) -> Trial | None:
    """Fit the colours of regions against all else; None if too little is left, or the rule misses the clicks."""
    whole = np.logical_or.reduce(parts)
    away = np.asarray(cv2.dilate(whole.view(np.uint8), _SQUARE, iterations=2)) == 0
    near = np.zeros_like(away)
    near[box(whole, _NEAR)] = away[box(whole, _NEAR)]
    if np.count_nonzero(away) < 100:
        return None
    colours = _mixture(photo, [core(part) for part in parts], _OBJECT_SAMPLES, _OBJECT_COLOURS + min(len(parts) - 1, 2))
    ground = _mixture(photo, [near, away], _GROUND_SAMPLES, _GROUND_COLOURS)
    for other in others:
        if other.any():
            ground += _mixture(photo, [core(other)], _OTHER_SAMPLES, _OTHER_COLOURS)
    rule = ClickedColours(object=colours, background=ground)
    odds = log_odds(photo.colours, colours, ground)
    found, clicked = pieces(masked(photo, odds, rule), rule, picks)
    if np.count_nonzero(clicked) < _SMALLEST:
        return None
    return Trial(rule, odds, found, clicked, _score(photo, found, clicked, picks, nots))


def _mixture(photo: Photo, masks: list[Mask], samples: int, count: int) -> tuple[ColourGaussian, ...]:
    """Fit a mixture to the colours of masks, each of which counts as much as another."""
    masks = [mask for mask in masks if mask.any()]
    return fit_colours(np.concatenate([photo.sample(mask, samples // len(masks)) for mask in masks]), count)


def masked(photo: Photo, odds: npt.NDArray[np.float64], rule: ClickedColours) -> Mask:
    """Return what a rule finds in the photo, with its clean-up."""
    return rule.clean((odds > rule.strictness)[photo.cells[1]].astype(np.uint8)).view(np.bool_)


def pieces(mask: Mask, rule: ClickedColours, picks: list[Pixel]) -> tuple[Mask, Mask]:
    """Return the plausible pieces of a mask, as a detector keeps them, and the pieces at clicks."""
    count, labels, sizes = _components(mask)
    areas = sizes.copy()
    areas[0] = 0
    keep = (areas >= rule.min_area) & (areas >= rule.min_share * areas.max()) & (areas > 0)
    at = np.zeros(count, np.bool_)
    for u, v in picks:
        near = np.bincount(labels[max(v - 2, 0) : v + 3, max(u - 2, 0) : u + 3].ravel(), minlength=count)
        near[0] = 0
        best = labels[v, u] or int(near.argmax())
        at[best] = best > 0
    return keep[labels], at[labels]


def hits(mask: Mask, picks: list[Pixel], nots: list[Pixel]) -> tuple[float, float]:
    """Return the shares of clicks on the object that are in a mask, or next to it, and of other clicks within it."""
    hit = float(np.mean([around(mask, pick) > 0 for pick in picks]))
    return hit, float(np.mean([around(mask, no) >= INSIDE for no in nots])) if nots else 0.0


def _score(photo: Photo, found: Mask, clicked: Mask, picks: list[Pixel], nots: list[Pixel]) -> float:
    if not found.any():
        return 0.0
    contrast = max(float(np.percentile(border_changes(photo, found), 10)), 0.5)
    spread = photo.sample(core(found), 1500).std(axis=0)
    variation = _VARIATION + float(np.linalg.norm(spread * (_OF_LIGHT, 1, 1)))
    hit, miss = hits(found, picks, nots)
    return contrast / variation * (0.02 + hit) * (1 - 0.9 * miss) * (1 - 0.7 * _unlike(found, clicked))


def _unlike(found: Mask, clicked: Mask) -> float:
    """Return the share of a mask in pieces that are much thinner or thicker than the clicked ones.

    Such are the borders of other things, where colours mix, and large things of the object's colour.
    """
    count, labels, sizes = _components(found)
    depth = np.asarray(cv2.distanceTransform(found.view(np.uint8), cv2.DIST_L2, 3))
    deepest = np.zeros(count)
    np.maximum.at(deepest, labels[found], depth[found])
    own = np.unique(labels[clicked & found])
    if not len(own):
        return 1.0
    width = deepest[own].max()
    unlike = (deepest < 0.55 * width - 0.3) | (deepest > 1.8 * width + 0.5)
    unlike[0] = False
    unlike[own] = False
    return float(sizes[unlike].sum() / max(np.count_nonzero(found), 1))


def _components(mask: Mask) -> tuple[int, npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """Return the number of labels, the label of each pixel, 0 outside the mask, and the pixels of each label."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.view(np.uint8), connectivity=8)
    return count, np.asarray(labels, np.int32), np.asarray(stats, np.int32)[:, cv2.CC_STAT_AREA]
