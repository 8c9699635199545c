"""From clicks on a photo to a segmentation that finds the object in every frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.image.click_regions import (
    INSIDE,
    Mask,
    Photo,
    Pixel,
    Trial,
    around,
    border_changes,
    hits,
    masked,
    pieces,
    trials,
)
from shape_obs.image.clicked_colours import ClickedColours
from shape_obs.image.segmentation import Segmentation

_LARGEST: Final = 960  # pixels: larger photos are reduced while clicks are interpreted
_STRICTNESS: Final = (0.0, -3.0, -1.5, 1.5, 3.0, 5.0, 8.0)
_STEEPER: Final = 1.03  # by how much edges must be steeper at another threshold
_MOST: Final = 0.6  # share of the image
_SAME: Final = 0.97  # intersection over union of masks that are as good as equal


@dataclass(frozen=True, eq=False)
class Proposal:
    """A segmentation that fits clicks on an image.

    Attributes:
        rule: The pixel rule, with its clean-up.
        mask: ``(H, W)`` bool, what the rule finds in this image.
        text: What was found, in plain words.
    """

    rule: Segmentation
    mask: Mask
    text: str


def propose_segmentation(
    rgb: npt.NDArray[np.uint8],
    picks: Sequence[tuple[float, float]],
    nots: Sequence[tuple[float, float]] = (),
    depth: npt.NDArray[Any] | None = None,
) -> Proposal:
    """Propose the segmentation of the object under some pixels.

    One click is often enough. If something is missing, click it too; if something else was taken, give a pixel of it in
    ``nots``. Where depth changes abruptly the object is taken to end, even if what is behind it has its colour.

    Args:
        rgb: ``(H, W, 3)`` uint8, RGB.
        picks: (u, v) on the object, at least one.
        nots: (u, v) that are not on the object.
        depth: ``(H, W)``, as a ``Frame`` takes it, aligned to rgb.

    Raises:
        ValueError: A pixel lies outside the image, or no rule separates the object from its surroundings.
    """
    height, width = rgb.shape[:2]
    if not picks:
        raise ValueError("pick: expected at least one pixel on the object, got none.")
    for u, v in (*picks, *nots):
        if not (0 <= round(u) < width and 0 <= round(v) < height):
            raise ValueError(f"pick: pixel ({u:g}, {v:g}) lies outside the image of {width} x {height} pixels.")
    scale = min(1.0, _LARGEST / max(height, width))
    small, depth_there = rgb, depth
    if scale < 1:
        size = round(width * scale), round(height * scale)
        small = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.uint8)
        depth_there = None if depth is None else np.asarray(cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST))
    photo = Photo(small, depth_there)
    on, off = _scaled(picks, scale, photo), _scaled(nots, scale, photo)
    # If something has the object's very colours, clicks on it cannot be obeyed; the text says so.
    tried = list(trials(photo, on, off)) or list(trials(photo, on, []))
    if not tried:
        raise ValueError(
            f"pick: nothing around {_listed(picks)} has a colour of its own; pick a pixel in the middle of the object, "
            "or give the colours with --hsv."
        )
    rule = _finished(photo, max(tried, key=lambda trial: trial.score), on, off)
    rule = replace(rule, picks=tuple(map(tuple, picks)), nots=tuple(map(tuple, nots)))
    mask = _found(rule, rgb)
    if mask.mean() > _MOST:
        raise ValueError(
            f"pick: {mask.mean():.0%} of the image looks like {_listed(picks)}; pick a pixel on the object, not on the "
            "background, or give pixels of the background with --not."
        )
    return Proposal(rule, mask, _explained(mask, picks, nots))


def _scaled(pixels: Sequence[tuple[float, float]], scale: float, photo: Photo) -> list[Pixel]:
    height, width = photo.shape
    return [(min(round(u * scale), width - 1), min(round(v * scale), height - 1)) for u, v in pixels]


def _finished(photo: Photo, best: Trial, picks: list[Pixel], nots: list[Pixel]) -> ClickedColours:
    """Return the rule with its threshold where edges are steepest, and with as little clean-up as is needed."""
    hit, area = hits(best.found, picks, nots)[0], np.count_nonzero(best.found)
    rule, steepest = best.rule, -1.0
    for strictness in _STRICTNESS:
        other = replace(best.rule, strictness=strictness)
        found, _ = pieces(masked(photo, best.odds, other), other, picks)
        if hits(found, picks, nots)[0] < hit or not 0.5 * area < np.count_nonzero(found) < 1.6 * area:
            continue
        steepness = float(border_changes(photo, found, -0.3, 1.3, smooth=False).mean())
        if steepness > _STEEPER * steepest:
            rule, steepest = other, steepness
    # What is thin may be the border of something else, where colours mix. The object must not lose by the opening, and
    # without any clean-up the fast search by colour is open to the detector.
    opened = replace(rule, open=3)
    plain, clicked = pieces(masked(photo, best.odds, rule), rule, picks)
    found, _ = pieces(masked(photo, best.odds, opened), opened, picks)
    kept = np.count_nonzero(opened.clean(clicked.astype(np.uint8))) > _SAME * np.count_nonzero(clicked)
    if kept and np.count_nonzero(plain & found) <= _SAME * np.count_nonzero(plain | found):
        rule = opened
    return _without_smaller_pieces(photo, best, rule, picks, nots)


def _without_smaller_pieces(
    photo: Photo, best: Trial, rule: ClickedColours, picks: list[Pixel], nots: list[Pixel]
) -> ClickedColours:
    """Raise ``min_share`` where that removes pieces of the object's colour which are not it."""
    mask = masked(photo, best.odds, rule)
    _, own = pieces(mask, rule, picks)
    wrong = [pieces(mask, rule, [no])[1] for no in nots if around(mask, no) >= INSIDE]
    wrong = [piece for piece in wrong if not (piece & own).any()]
    labels = np.asarray(cv2.connectedComponents(own.view(np.uint8), connectivity=8)[1])
    areas = np.bincount(labels.ravel())[1:]
    if not wrong or not len(areas):
        return rule
    share = 1.05 * max(np.count_nonzero(piece) for piece in wrong) / areas.max()
    return replace(rule, min_share=round(share, 3)) if share < areas.min() / areas.max() else rule


def _found(rule: ClickedColours, rgb: npt.NDArray[np.uint8]) -> Mask:
    """Return what a detector finds with the rule in an image."""
    mask = rule.clean(rule.matches(rgb).astype(np.uint8)).view(np.bool_)
    return pieces(mask, rule, [])[0]


def _explained(mask: Mask, picks: Sequence[tuple[float, float]], nots: Sequence[tuple[float, float]]) -> str:
    """Say what was found, and which clicks could not be obeyed."""
    count = cv2.connectedComponents(mask.view(np.uint8), connectivity=8)[0] - 1
    lines = [f"{np.count_nonzero(mask):,} pixels in {count} piece{'s' if count != 1 else ''} look like the object."]
    rounded = [[(round(u), round(v)) for u, v in pixels] for pixels in (picks, nots)]
    missed = [pixel for pixel in rounded[0] if not around(mask, pixel)]
    wrong = [pixel for pixel in rounded[1] if around(mask, pixel) >= INSIDE]
    if missed:
        lines.append(f"{_listed(missed)} could not be added: the colours there are those of the background.")
    if wrong:
        lines.append(
            f"{_listed(wrong)} could not be excluded: the colours there are the object's; limit the region of interest."
        )
    return " ".join(lines)


def _listed(pixels: Sequence[tuple[float, float]]) -> str:
    return ", ".join(f"({u:g}, {v:g})" for u, v in pixels)
