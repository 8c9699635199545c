"""From clicks on a photo to a segmentation that finds the object in every frame.

clicks -> the network's mask -> the rope through the clicks -> a rule for the frames to come: the colours of that mask
if they give it again, else the network in each frame.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.frame import Frame, depth_in_metres
from shape_obs.image.click_net import HALF, Clicks, Photo, Pixel, as_lab, distances_of_colours, load_network
from shape_obs.image.clicked_colours import LIGHTS, ClickedColours, fit_rule
from shape_obs.image.find_region import find_region
from shape_obs.image.roi import Window
from shape_obs.image.segmentation import Expected, FollowingRule, Segmentation, need
from shape_obs.image.sharing import FOUND, MOST, TRACED, part_of, share
from shape_obs.initialization.objects import SceneObject
from shape_obs.initialization.pairing import NARROW
from shape_obs.initialization.ropes import find_ropes
from shape_obs.spec import SpecError

Image = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]
Pixels = Sequence[Pixel] | npt.NDArray[Any]

_SMALLEST, _LARGEST = 32, 960  # pixels of a photo's sides: smaller ones show nothing, larger ones are reduced
_AT: Final = 2  # pixels around a click that count as clicked
_NEAR: Final = 3.0  # pixels by which the borders of two masks of one object may differ
_DIFFERENT: Final = 0.05  # share of either of two masks of one object that may be farther from the other
_ROPE: Final = 11.0  # times as long as it is wide; garments are up to 9 times
# How much colours add to the log odds of the network, and from where they are as sure as they can be; how often.
_WEIGHT, _SURE, _ROUNDS = 0.5, 4.0, 2
_CERTAIN: Final = 1 / (1 + math.exp(-_WEIGHT * _SURE))  # the probability from which colours do not matter
_AROUND: Final = 5, 15  # pixels of the squares by which a mask grows to where its surroundings begin and end
_CONTRAST: Final = 4.0  # distance in Lab of an object from its surroundings; drawn objects are 9 or more away
_STEP: Final = 0.006, 0.015  # metres, and share of the distance: a change of depth that separates things
_FARTHEST: Final = 1e6  # metres, beyond all that is seen
_DEEP: Final = 0.03  # metres by which parts of one object lie before or behind others, beyond a step
_PLAUSIBLE: Final = Segmentation.min_area, Segmentation.min_share
_GAP: Final = 6.0  # widths of a gap that cost a nat: what may hide a rope, such as a hand, is up to 15 wide
_LIKE: Final = 14.0  # distance to the colour of a click, see ``distances_of_colours``: it still looks the same there
_PIXELS_NEAR: Final = 100_000  # of the surroundings of a track, as the network sees them: it looks at these once
_FEWEST: Final = 4  # places of a track on the rope that it follows; where another one crosses there are fewer
_MOTION: Final = 16  # pixels by which an object may lie off the place where it is expected
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
    rgb: Image, picks: Pixels, nots: Pixels = (), depth: npt.NDArray[Any] | None = None
) -> Proposal:
    """Propose the segmentation of the object under some pixels.

    One click is often enough. If something is missing, click it too; if something else was taken, give a pixel of it in
    ``nots``. The rule for the frames to come is a table of colours where these give the mask again, else a small
    network that looks at each frame.

    Args:
        rgb: ``(H, W, 3)`` uint8, RGB.
        picks: (u, v) on the object, at least one.
        nots: (u, v) that are not on the object.
        depth: ``(H, W)``, as a ``Frame`` takes it, aligned to rgb: what lies at another depth than the object, beyond a
            step, is not it.

    Raises:
        TypeError: The image is none, see ``Frame``, or a click is no pair of numbers.
        ValueError: A pixel lies outside the image, clicks contradict each other, or there is no object under them.
    """
    frame = Frame(rgb, depth)
    picks, nots = _pixels("pick", picks), _pixels("not", nots)
    _check(frame.rgb, picks, nots)
    small, on_it, off_it = _reduced(rgb, picks, nots)
    photo = Photo(small)
    on, off = (Clicks.at(photo.lab, photo.here(pixels)) for pixels in (on_it, off_it))
    seen, colours = _with_colours(small, photo.probability(on, off))
    if frame.depth is not None:
        there = cv2.resize(depth_in_metres(frame.depth), small.shape[1::-1], interpolation=cv2.INTER_NEAREST)
        seen = _at_one_depth(seen, np.asarray(there, np.float32), on_it)
        colours = fit_rule(small, seen)  # what lies at another depth is not the object's
    elif _contrast(seen, small) < _CONTRAST:
        seen = np.zeros_like(seen)  # a piece of the ground
    if not any(_near(seen, pick).any() for pick in on_it):
        raise ValueError(
            f"pick: nothing at {_listed(picks)} stands out from what is around it; click in the middle of the object."
        )
    mask = _ropes_at(seen, small, on_it, off_it)
    if colours is not None and all(_is_same(_found(colours, _relit(small, gain)), mask) for gain in LIGHTS):
        rule: Segmentation = replace(colours, picks=picks, nots=nots)
    else:
        clicked = _rows(on.colours), _rows(off.colours)
        rule = ClickNet(picks=picks, nots=nots, object=clicked[0], background=clicked[1], colours=colours)
    if small is not rgb:
        mask = cv2.resize(mask.view(np.uint8), rgb.shape[1::-1], interpolation=cv2.INTER_NEAREST) > 0
    if mask.mean() > _MOST:
        raise ValueError(
            f"pick: {mask.mean():.0%} of the image looks like {_listed(picks)}; click on the object, not on the "
            "background, or give pixels of the background with --not."
        )
    return Proposal(rule, mask, _explained(rule, mask, picks, nots))


def _pixels(name: str, pixels: Pixels) -> tuple[Pixel, ...]:
    try:
        return tuple((float(u), float(v)) for u, v in pixels)
    except (TypeError, ValueError) as error:
        raise TypeError(f"{name}: expected pixels [(u, v), ...], got {pixels!r:.80}.") from error


def _check(rgb: Image | None, picks: Sequence[Pixel], nots: Sequence[Pixel]) -> None:
    height, width = (0, 0) if rgb is None else rgb.shape[:2]
    if min(height, width) < _SMALLEST:
        size = f"{_SMALLEST} x {_SMALLEST}"
        raise ValueError(f"pick: expected an image of at least {size} pixels, got {width} x {height}.")
    if not picks:
        raise ValueError("pick: expected at least one pixel on the object, got none.")
    for u, v in (*picks, *nots):
        if not (-0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5):
            raise ValueError(f"pick: pixel ({u:g}, {v:g}) lies outside the image of {width} x {height} pixels.")
    for pick, no in product(picks, nots):
        if math.dist(pick, no) <= _AT:
            raise ValueError(f"pick: {_listed([pick])} is given as on the object, and {_listed([no])} as off it.")


def _reduced(rgb: Image, *clicks: Sequence[Pixel]) -> tuple[Image, Sequence[Pixel], Sequence[Pixel]]:
    """Return a photo of at most so many pixels, and the clicks on it."""
    scale = min(1.0, _LARGEST / max(rgb.shape))
    size = round(rgb.shape[1] * scale), round(rgb.shape[0] * scale)
    small = rgb if scale == 1 else np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.uint8)
    on, off = ([(min(u * scale, size[0] - 1), min(v * scale, size[1] - 1)) for u, v in each] for each in clicks)
    return small, on, off


def _with_colours(rgb: Image, probability: npt.NDArray[np.float32]) -> tuple[Mask, ClickedColours | None]:
    """Return the mask that a probability and the colours fitted to that mask agree on, and the rule of those."""
    seen, rule = probability > HALF, None
    for _ in range(_ROUNDS):
        rule = fit_rule(rgb, seen)
        if rule is not None:
            seen = _fused(probability, rgb, rule)
    return seen, rule


def _fused(probability: npt.NDArray[np.float32], rgb: Image, colours: ClickedColours) -> Mask:
    """Return the mask that a probability and colours agree on.

    Log odds are added, those of colours at less weight: pixels of one colour are not independent. The network
    sees shapes, at a lower resolution; the colours draw borders and thin lines more sharply.
    """
    seen = probability > _CERTAIN
    unsure = (probability > 1 - _CERTAIN) & ~seen
    if unsure.any():
        p, of_colour = probability[unsure], colours.log_odds(rgb[unsure][None])[0]  # (K,)
        seen[unsure] = np.log(p / (1 - p)) + _WEIGHT * np.clip(of_colour, -_SURE, _SURE) > 0
    return seen


def _contrast(seen: Mask, rgb: Image) -> float:
    """Return the distance in Lab of the colour of a mask from that of what is around it; 0 without either."""
    near, far = (cv2.dilate(seen.view(np.uint8), np.ones((side, side), np.uint8)) > 0 for side in _AROUND)
    own, around = rgb[seen], rgb[far & ~near]  # (K, 3)
    if not (len(own) and len(around)):
        return 0.0
    return float(np.linalg.norm(np.subtract(*(np.median(as_lab(part[None])[0], axis=0) for part in (own, around)))))


def _at_one_depth(seen: Mask, metres: npt.NDArray[np.float32], picks: Sequence[Pixel]) -> Mask:
    """Return the parts of a mask, cut at steps of depth, that lie about as far away as those that were clicked."""
    far, near = (np.where(np.isfinite(metres), metres, side) for side in (0.0, _FARTHEST))
    step = cv2.dilate(far, np.ones((3, 3), np.uint8)) - cv2.erode(near, np.ones((3, 3), np.uint8))
    even = np.isfinite(metres) & (step <= np.maximum(_STEP[0], _STEP[1] * near))
    count, labels = cv2.connectedComponents((seen & even).view(np.uint8))
    parts = np.asarray(labels, np.intp)
    low, high = (np.full(count, side) for side in (np.inf, -np.inf))
    np.minimum.at(low, parts.ravel(), near.ravel())
    np.maximum.at(high, parts.ravel(), far.ravel())
    own = np.unique([parts[round(v), round(u)] for u, v in picks])
    own = own[own > 0]
    if not len(own):
        return seen
    alike = (low <= high[own].max() + _DEEP) & (high >= low[own].min() - _DEEP)
    alike[0] = True  # the steps themselves, and where depth is unknown
    return seen & alike[parts]


def _ropes_at(
    seen: Mask, rgb: Image, picks: Sequence[Pixel], nots: Sequence[Pixel], gap: float = _GAP, least: int = 1
) -> Mask:
    """Return the ropes of a mask that have ``least`` of the picks and no not, over all crossings; else all of the mask.

    Ropes of one colour look alike to the network; which way each goes is a matter of its curve.
    """
    region = find_region(seen.view(np.uint8), _whole(seen), *_PLAUSIBLE)
    whole = region.mask > 0
    ropes = find_ropes(region, rgb, gap)[0] if region.area and region.length > _ROPE * region.width else []
    on, off = (Counter(_nearest(ropes, pixel) for pixel in pixels) for pixels in (picks, nots))
    clicked = [k for k, count in on.items() if k is not None and count >= least and k not in off]
    if not clicked or len(ropes) > MOST or len(ropes) == least == 1:
        return whole
    reach = FOUND if least == 1 else TRACED  # what sticks out of a rope that is known is not its own
    owners, _, _ = share(region, [rope.curve.points for rope in ropes], [rope.width for rope in ropes], reach)
    part, mask = part_of(region, owners, clicked, *_PLAUSIBLE), np.zeros_like(whole)
    mask[part.window.slices] = part.mask > 0
    return mask


def _parts_at(seen: Mask, expected: npt.NDArray[np.uint8]) -> Mask:
    """Return the connected parts of a mask that mostly lie where it is expected, about; all of them if none does."""
    count, found = cv2.connectedComponents(seen.view(np.uint8))
    labels = np.asarray(found, np.intp)
    near = cv2.dilate(expected, np.ones((2 * _MOTION + 1,) * 2, np.uint8)) > 0
    area, there = (np.bincount(labels[part], minlength=count) for part in (seen, seen & near))
    mostly = there > area / 2
    return mostly[labels] if mostly.any() else seen


def _nearest(ropes: Sequence[SceneObject], pixel: Pixel) -> int | None:
    """Return the rope that lies at a pixel, or nearly."""
    beyond = [float(np.linalg.norm(each.curve.points - pixel, axis=1).min()) - each.width / 2 for each in ropes]
    return int(np.argmin(beyond)) if min(beyond, default=math.inf) <= _AT else None


def _found(rule: ClickedColours, rgb: Image) -> Mask:
    """Return what a detector finds with the rule in an image."""
    mask = rule.clean(rule.matches(rgb).astype(np.uint8))
    return find_region(mask, _whole(mask), rule.min_area, rule.min_share).mask > 0


def _relit(rgb: Image, gain: float) -> Image:
    return np.clip(rgb * gain, 0, 255).astype(np.uint8)


def _whole(mask: npt.NDArray[Any]) -> Window:
    return Window(0, 0, mask.shape[1], mask.shape[0])


def _is_same(one: Mask, other: Mask) -> bool:
    """Return whether two masks show the same object, about: hardly anything of either is far from the other."""
    far = [
        np.count_nonzero(cv2.distanceTransform((~of).view(np.uint8), cv2.DIST_L2, 3)[some] > _NEAR)
        > _DIFFERENT * np.count_nonzero(some)
        for some, of in ((one, other), (other, one))
    ]
    return not any(far) and bool(one.any())


def _near(mask: npt.NDArray[Any], pixel: Pixel) -> npt.NDArray[Any]:
    u, v = round(pixel[0]), round(pixel[1])
    return mask[max(v - _AT, 0) : v + _AT + 1, max(u - _AT, 0) : u + _AT + 1]


def _explained(rule: Segmentation, mask: Mask, picks: Sequence[Pixel], nots: Sequence[Pixel]) -> str:
    """Say what was found, how it is found from now on, and which clicks could not be obeyed."""
    count, labels = cv2.connectedComponents(mask.view(np.uint8), connectivity=8)
    clicked = {int(_near(np.asarray(labels), pick).max()) for pick in picks} - {0}
    lines = [
        f"{np.count_nonzero(mask):,} pixels in {count - 1} piece{'s' if count != 2 else ''} are the object's.",
        "Its colours find it in later frames."
        if isinstance(rule, ClickedColours)
        else "A network looks for it in each later frame: other things have its colours.",
    ]
    if len(clicked) > 1:
        lines.append(f"Clicks lie in {len(clicked)} of the pieces; if they are two objects, click each separately.")
    if missed := [pick for pick in picks if not _near(mask, pick).any()]:
        lines.append(f"{_listed(missed)} could not be added.")
    if wrong := [no for no in nots if _near(mask, no).all()]:
        lines.append(f"{_listed(wrong)} could not be excluded; limit the region of interest.")
    return " ".join(lines)


def _listed(pixels: Sequence[Pixel]) -> str:
    return ", ".join(f"({u:g}, {v:g})" for u, v in pixels)


def _rows(colours: npt.NDArray[np.float32]) -> tuple[tuple[float, float, float], ...]:
    rounded = np.round(colours.astype(np.float64), 2).tolist()
    return tuple((light, a, b) for light, a, b in rounded)


@dataclass(frozen=True)
class ClickNet(FollowingRule, kind="click_net"):
    """Pixels that a small network takes for the object that was clicked, in each frame.

    ``propose_segmentation`` chooses it where colours alone do not separate the object from all else. It looks around
    the place where the track expects the object; what is lost is looked for everywhere by the colours of the clicks.

    Args:
        picks: (u, v) of the clicks on the object; kept for the record, no pixel is read there again.
        nots: (u, v) of the clicks that are not on the object.
        object: The colours under the clicks on it, (L, a, b) of CIE Lab; L 0...100.
        background: Those under the other clicks.
        colours: The colours of all of the object and of its surroundings, which decide where the network is not sure.
    """

    picks: tuple[tuple[float, float], ...] = ()
    nots: tuple[tuple[float, float], ...] = ()
    object: tuple[tuple[float, float, float], ...] = ()
    background: tuple[tuple[float, float, float], ...] = ()
    colours: ClickedColours | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.object or not np.isfinite([*self.object, *self.background]).all():
            raise SpecError(
                f"click_net: expected at least one colour (L, a, b) of the object, got {self.object}; `shape-obs "
                "detect IMAGE --pick u,v` and shape_obs.clicks.propose_segmentation read them from an image."
            )

    def prepare(self) -> None:
        """Load the network."""
        load_network()

    def threshold(self, frame: Frame, window: Window) -> npt.NDArray[np.bool_]:
        """Look everywhere in a window, by the colours, and by the clicks where it still looks as it did there."""
        rgb = need(frame.rgb, "rgb", self)[window.slices]
        photo, places = Photo(rgb), np.array(self.picks).reshape(-1, 2) - (window.left, window.top)
        on, off, known = self._clicks(photo, places)
        return _ropes_at(self._seen(rgb, photo.probability(on, off)), rgb, places[known].tolist(), [])

    def threshold_near(self, frame: Frame, window: Window, expected: Expected) -> npt.NDArray[np.bool_]:
        """Look once around the places that are expected; those that look otherwise are not believed."""
        rgb = need(frame.rgb, "rgb", self)[window.slices]
        photo, places = Photo(rgb, _PIXELS_NEAR), expected.places - (window.left, window.top)
        before = cv2.resize(expected.mask[window.slices], photo.rgb.shape[1::-1], interpolation=cv2.INTER_AREA)
        on, off, known = self._clicks(photo, places)
        found = self._seen(rgb, photo.probability(on, off, np.asarray(before, np.float32), passes=1))
        if expected.ropes:
            gap = _GAP if expected.anywhere else NARROW
            return _ropes_at(found, rgb, places[known].tolist(), [], gap, _FEWEST)
        return found if expected.anywhere else _parts_at(found, expected.mask[window.slices])

    def _seen(self, rgb: Image, probability: npt.NDArray[np.float32]) -> Mask:
        return probability > HALF if self.colours is None else _fused(probability, rgb, self.colours)

    def _clicks(self, photo: Photo, pixels: npt.NDArray[np.float64]) -> tuple[Clicks, Clicks, npt.NDArray[np.bool_]]:
        """Return clicks of the colours that were clicked, at those pixels that look like one of them, and which do."""
        on, off = (np.array(each, np.float32).reshape(-1, 3) for each in (self.object, self.background))
        inside = np.all((pixels >= 0) & (pixels <= np.array(photo.size) - 1), axis=1)
        here = Clicks.at(photo.lab, photo.here(pixels))
        known = inside & (distances_of_colours(here.colours[None], on)[0][0] < _LIKE)
        return Clicks(here.places[known], on), Clicks(colours=off), known
