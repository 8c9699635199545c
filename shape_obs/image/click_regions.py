"""What clicks on a photo may mean: regions of one colour around them, and rules that separate each from the rest.

A click may mean a wire, the bundle it runs in or the table; so several regions around it are tried. For each one a
mixture of colours is fitted to it and another one to all else (as in GrabCut: Rother, Kolmogorov and Blake, 2004, but
without a smoothness term, which would cut thin wires off). The best rule finds something with a border that stands out
against the variation within.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.frame import depth_in_metres
from shape_obs.image.clicked_colours import (
    ClickedColours,
    ColourGaussian,
    as_lab,
    cells_of,
    colours_of,
    fit_colours,
    log_odds,
)

Mask = npt.NDArray[np.bool_]
Pixel = tuple[int, int]

_SQUARE: Final = np.ones((3, 3), np.uint8)
_TOLERANCES: Final = (4, 6, 8, 10, 13, 16, 20, 25, 31)  # distance of colours in Lab
_LIGHT_WEIGHTS: Final = (0.12, 1.0)  # of squared differences of lightness: light and shadow differ in it most
_SMALLEST, _LARGEST, _GROWN = 15, 0.6, 1.05  # pixels; share of the image; by how much the next region must be larger
_BORDER: Final = 2000  # pixels of a border that are looked at
_STEP: Final = 0.006, 0.015  # metres, and share of the distance: a change of depth that separates things

_REGIONS: Final = 4  # regions around a click that are tried
_NEAR: Final = 25  # pixels around an object that count as its surroundings
_OBJECT_SAMPLES, _GROUND_SAMPLES, _OTHER_SAMPLES = 800, 1400, 500
_OBJECT_COLOURS, _GROUND_COLOURS, _OTHER_COLOURS = 3, 5, 3
_VARIATION: Final = 5.0  # of the colours of an object, in Lab; less counts as so much
_OF_LIGHT: Final = 0.35  # weight of variation of lightness
_LEAST_CLICKED: Final = 10  # pixels around clicks
INSIDE: Final = 8  # of the 3 x 3 pixels around a click: it lies in a mask, not on its border


class Photo:
    """A photo in the form in which clicks are interpreted.

    Args:
        rgb: ``(H, W, 3)`` uint8.
        depth: ``(H, W)`` as a ``Frame`` has it, or None.

    Attributes:
        lab: ``(H, W, 3)`` float32, CIE Lab.
        smooth: The same without the noise of single pixels.
        cells: The cells of Lab that occur, and of each pixel its place among them, ``(H, W)``.
        steps: ``(H, W)`` bool, where depth changes abruptly; None without depth.
    """

    def __init__(self, rgb: npt.NDArray[np.uint8], depth: npt.NDArray[Any] | None) -> None:
        self.rgb, self.shape = rgb, rgb.shape[:2]
        stored = cv2.cvtColor(rgb, cv2.COLOR_RGB2LAB)
        self.lab, self.smooth = as_lab(stored), as_lab(np.asarray(cv2.medianBlur(stored, 3)))
        cells = cells_of(rgb)
        occurring, places = np.unique(cells, return_inverse=True)
        self.cells = occurring, places.reshape(cells.shape)
        self.colours = colours_of(occurring)
        self.steps = None if depth is None else _depth_steps(depth)
        self.rng = np.random.default_rng(0)  # samples are the same for the same clicks

    def sample(self, mask: Mask, count: int) -> npt.NDArray[np.float64]:
        """Return the smoothed colours of at most ``count`` pixels of a mask, ``(K, 3)``."""
        chosen = np.flatnonzero(mask)
        if len(chosen) > count:
            chosen = self.rng.choice(chosen, count, replace=False)
        return self.smooth.reshape(-1, 3)[chosen].astype(np.float64)


@dataclass(frozen=True, eq=False)
class Region:
    """Connected pixels of about one colour.

    Args:
        mask: ``(H, W)`` bool.
        contrast: By how much colours change across most of its border, in Lab.
    """

    mask: Mask
    contrast: float


def regions_at(photo: Photo, pixel: Pixel) -> list[Region]:
    """Return the regions around a pixel for several tolerances, the one with the clearest border first."""
    u, v = pixel
    square = np.s_[max(v - 1, 0) : v + 2, max(u - 1, 0) : u + 2]
    colour = np.median(photo.smooth[square].reshape(-1, 3), axis=0)
    difference = (photo.smooth - colour.astype(np.float32)) ** 2
    found = []
    for weight in _LIGHT_WEIGHTS:
        distance = weight * difference[..., 0] + difference[..., 1] + difference[..., 2]
        last = 0.0
        for tolerance in _TOLERANCES:
            like = distance <= tolerance**2
            like[square] |= distance[square] <= (2 * tolerance) ** 2
            if photo.steps is not None and not photo.steps[square].any():
                like &= ~photo.steps
            mask = connected(like, pixel)
            area = np.count_nonzero(mask)
            if max(_SMALLEST, _GROWN * last) <= area <= _LARGEST * mask.size:
                last = area
                found.append(Region(mask, float(np.percentile(border_changes(photo, mask), 25))))
    return sorted(found, key=lambda region: -region.contrast)


def connected(mask: Mask, pixel: Pixel) -> Mask:
    """Return the pixels of a mask that are connected with one of them; none if that is not in the mask."""
    u, v = pixel
    if not mask[v, u]:
        return np.zeros_like(mask)
    labels = np.asarray(cv2.connectedComponents(mask.view(np.uint8), connectivity=8)[1])
    return labels == labels[v, u]


def around(mask: Mask, pixel: Pixel) -> int:
    """Return how many pixels of a mask lie in the 3 x 3 pixels around one."""
    u, v = pixel
    return int(np.count_nonzero(mask[max(v - 1, 0) : v + 2, max(u - 1, 0) : u + 2]))


def core(mask: Mask) -> Mask:
    """Return a mask without its border, where colours are mixed; all of it where little would be left."""
    inner = np.asarray(cv2.erode(mask.view(np.uint8), _SQUARE)).view(np.bool_)
    return inner if np.count_nonzero(inner) >= 0.3 * np.count_nonzero(mask) else mask


def border_changes(
    photo: Photo, mask: Mask, inside: float = -1.0, outside: float = 2.0, *, smooth: bool = True
) -> npt.NDArray[np.float32]:
    """Return by how much the colour changes across the border of a mask, at many places of it.

    Args:
        photo: The photo.
        mask: ``(H, W)`` bool.
        inside: Where to look within the mask, pixels from its outermost pixels along the outward normal.
        outside: The same for the other side.
        smooth: Whether to look at the smoothed photo.

    Returns:
        ``(K,)`` distances in Lab; a single 0 where the mask has hardly a border.
    """
    if not mask.any():
        return np.zeros(1, np.float32)
    window = box(mask, 4)
    part = np.ascontiguousarray(mask[window]).view(np.uint8)
    lab = np.ascontiguousarray((photo.smooth if smooth else photo.lab)[window])
    inner = np.asarray(cv2.erode(part, _SQUARE, borderType=cv2.BORDER_REPLICATE))
    rows, columns = np.nonzero(part > inner)
    if len(rows) < 8:
        return np.zeros(1, np.float32)
    if len(rows) > _BORDER:
        some = photo.rng.choice(len(rows), _BORDER, replace=False)
        rows, columns = rows[some], columns[some]
    soft = cv2.GaussianBlur(part.astype(np.float32), (0, 0), 1.2)
    across = np.asarray(cv2.Sobel(soft, cv2.CV_32F, 1, 0), np.float32)[rows, columns]
    down = np.asarray(cv2.Sobel(soft, cv2.CV_32F, 0, 1), np.float32)[rows, columns]
    normal = -np.stack([across, down]) / np.maximum(np.hypot(across, down), 1e-9)

    def at(distance: float) -> npt.NDArray[np.float32]:
        u, v = (np.stack([columns, rows]) + distance * normal).astype(np.float32)
        looked_up = cv2.remap(lab, u[None], v[None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(looked_up, np.float32)[0]

    return np.linalg.norm(at(outside) - at(inside), axis=1)


def box(mask: Mask, pad: int) -> tuple[slice, slice]:
    """Return the rows and columns of a mask that is not empty, with ``pad`` more on each side."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return slice(max(rows[0] - pad, 0), rows[-1] + pad + 1), slice(max(columns[0] - pad, 0), columns[-1] + pad + 1)


def _depth_steps(depth: npt.NDArray[Any]) -> Mask:
    """Return where depth changes abruptly between neighbours; where there is none it is not known to."""
    metres = depth_in_metres(depth).astype(np.float32)
    unknown = ~np.isfinite(metres)
    high = np.asarray(cv2.dilate(np.where(unknown, -np.inf, metres).astype(np.float32), _SQUARE))
    low = np.asarray(cv2.erode(np.where(unknown, np.inf, metres).astype(np.float32), _SQUARE))
    with np.errstate(invalid="ignore"):
        return (high - low > np.maximum(_STEP[0], _STEP[1] * low)) & ~unknown


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
    if np.count_nonzero(clicked) < _LEAST_CLICKED:
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
