"""From clicks on a photo to a segmentation that finds the object in every frame.

clicks -> the network's mask -> the rope through the clicks -> a rule for the frames to come: the colours of that mask
if they give it again, else the network in each frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.frame import Frame
from shape_obs.image.click_net import HALF, ClickNet, Clicks, Photo, Pixel
from shape_obs.image.clicked_colours import ClickedColours, fit_rule
from shape_obs.image.find_region import find_region
from shape_obs.image.region import Region
from shape_obs.image.roi import Window
from shape_obs.image.segmentation import Segmentation
from shape_obs.image.sharing import FOUND, MOST, part_of, share
from shape_obs.initialization.ropes import find_ropes

Image = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]

_SMALLEST: Final = 32  # pixels of a photo's shorter side, at least
_AT: Final = 2  # pixels around a click that count as clicked
_SAME: Final = 0.8  # intersection over union of masks that are the same object
_ROPE: Final = 5.0  # times as long as it is wide
_PLAUSIBLE: Final = Segmentation.min_area, Segmentation.min_share
_MOST: Final = 0.6  # share of the image


@dataclass(frozen=True, eq=False)
class Proposal:
    """A segmentation that fits clicks on an image.

    Attributes:
        rule: The pixel rule, with its clean-up.
        mask: ``(H, W)`` bool, the object in this image.
        text: What was found, and how later frames are segmented, in plain words.
    """

    rule: Segmentation
    mask: Mask
    text: str


def propose_segmentation(
    rgb: Image, picks: Sequence[Pixel], nots: Sequence[Pixel] = (), depth: npt.NDArray[Any] | None = None
) -> Proposal:
    """Propose the segmentation of the object under some pixels.

    One click is often enough. If something is missing, click it too; if something else was taken, give a pixel of it in
    ``nots``. The rule for the frames to come is a table of colours where these give the mask again, else a small
    network that looks at each frame.

    Args:
        rgb: ``(H, W, 3)`` uint8, RGB.
        picks: (u, v) on the object, at least one.
        nots: (u, v) that are not on the object.
        depth: ``(H, W)``, as a ``Frame`` takes it, aligned to rgb: the object ends where it changes abruptly.

    Raises:
        TypeError: The image is none, see ``Frame``.
        ValueError: A pixel lies outside the image, clicks contradict each other, or there is no object under them.
    """
    given = Frame(rgb, depth)
    rgb = given.rgb if given.rgb is not None else rgb
    _check(rgb, picks, nots)
    photo = Photo(rgb)
    on, off = (Clicks.at(photo.lab, photo.here(pixels)) for pixels in (picks, nots))
    seen = photo.probability(on, off) > HALF
    if not any(_near(seen, pick).any() for pick in picks):
        raise ValueError(
            f"pick: nothing at {_listed(picks)} stands out from what is around it; click in the middle of the object."
        )
    colours = fit_rule(rgb, seen)
    mask = _rope_at(_pieces(seen), rgb, picks)
    rule: Segmentation = ClickNet(
        picks=_plain(picks), nots=_plain(nots), object=_rows(on.colours), background=_rows(off.colours)
    )
    if colours is not None and _overlap(found := _found(colours, rgb), mask) >= _SAME:
        rule, mask = replace(colours, picks=_plain(picks), nots=_plain(nots)), found
    if mask.mean() > _MOST:
        raise ValueError(
            f"pick: {mask.mean():.0%} of the image looks like {_listed(picks)}; click on the object, not on the "
            "background, or give pixels of the background with --not."
        )
    return Proposal(rule, mask, _explained(rule, mask, picks, nots))


def _check(rgb: Image, picks: Sequence[Pixel], nots: Sequence[Pixel]) -> None:
    height, width = rgb.shape[:2]
    if min(height, width) < _SMALLEST:
        raise ValueError(
            f"pick: expected an image of {_SMALLEST} x {_SMALLEST} pixels or more, got {width} x {height}."
        )
    if not picks:
        raise ValueError("pick: expected at least one pixel on the object, got none.")
    for u, v in (*picks, *nots):
        if not (0 <= round(u) < width and 0 <= round(v) < height):
            raise ValueError(f"pick: pixel ({u:g}, {v:g}) lies outside the image of {width} x {height} pixels.")
    for pick in picks:
        for no in nots:
            if np.hypot(pick[0] - no[0], pick[1] - no[1]) <= _AT:
                raise ValueError(f"pick: {_listed([pick])} is given as on the object and {_listed([no])} as off it.")


def _pieces(mask: Mask) -> Region:
    """Return the plausible pieces of a mask, as a detector keeps them."""
    return find_region(mask.view(np.uint8), Window(0, 0, mask.shape[1], mask.shape[0]), *_PLAUSIBLE)


def _rope_at(region: Region, rgb: Image, picks: Sequence[Pixel]) -> Mask:
    """Return the ropes of a mask that were clicked, over all crossings; all of a mask that is no rope."""
    whole = region.mask > 0
    if not region.area or region.length < _ROPE * region.width:
        return whole
    ropes, _ = find_ropes(region, rgb)
    if not 1 < len(ropes) <= MOST:
        return whole
    curves, widths = [rope.curve.points for rope in ropes], [rope.width for rope in ropes]
    clicked = [k for k in range(len(ropes)) if any(_reaches(curves[k], widths[k], pick) for pick in picks)]
    if not clicked:
        return whole
    owners, _, _ = share(region, curves, widths, FOUND)
    part = part_of(region, owners, clicked, *_PLAUSIBLE)
    mask = np.zeros_like(whole)
    mask[part.window.slices] = part.mask > 0
    return mask


def _reaches(curve: npt.NDArray[np.float64], width: float, pixel: Pixel) -> bool:
    """Return whether a ribbon has a pixel, or nearly."""
    return float(np.min(np.linalg.norm(curve - pixel, axis=1))) <= width / 2 + _AT


def _found(rule: ClickedColours, rgb: Image) -> Mask:
    """Return what a detector finds with the rule in an image."""
    mask = rule.clean(rule.matches(rgb).astype(np.uint8))
    return find_region(mask, Window(0, 0, rgb.shape[1], rgb.shape[0]), rule.min_area, rule.min_share).mask > 0


def _overlap(one: Mask, other: Mask) -> float:
    """Return the intersection over the union of two masks."""
    return float(np.count_nonzero(one & other) / max(np.count_nonzero(one | other), 1))


def _near(mask: Mask, pixel: Pixel) -> Mask:
    u, v = round(pixel[0]), round(pixel[1])
    return mask[max(v - _AT, 0) : v + _AT + 1, max(u - _AT, 0) : u + _AT + 1]


def _explained(rule: Segmentation, mask: Mask, picks: Sequence[Pixel], nots: Sequence[Pixel]) -> str:
    """Say what was found, how it is found from now on, and which clicks could not be obeyed."""
    count = cv2.connectedComponents(mask.view(np.uint8), connectivity=8)[0] - 1
    lines = [
        f"{np.count_nonzero(mask):,} pixels in {count} piece{'s' if count != 1 else ''} are the object's.",
        "Its colours find it in later frames."
        if isinstance(rule, ClickedColours)
        else "A network looks for it in each later frame: other things have its colours.",
    ]
    if missed := [pick for pick in picks if not _near(mask, pick).any()]:
        lines.append(f"{_listed(missed)} could not be added.")
    if wrong := [no for no in nots if _near(mask, no).all()]:
        lines.append(f"{_listed(wrong)} could not be excluded; limit the region of interest.")
    return " ".join(lines)


def _listed(pixels: Sequence[Pixel]) -> str:
    return ", ".join(f"({u:g}, {v:g})" for u, v in pixels)


def _plain(pixels: Sequence[Pixel]) -> tuple[Pixel, ...]:
    return tuple((float(u), float(v)) for u, v in pixels)


def _rows(colours: npt.NDArray[np.float32]) -> tuple[tuple[float, float, float], ...]:
    return tuple((round(float(a), 2), round(float(b), 2), round(float(c), 2)) for a, b, c in colours)
