"""Attempts: fits of several slots to one frame, not yet followed, and what speaks against them."""

from __future__ import annotations

from itertools import combinations, cycle, permutations
from statistics import median
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.observed import Observed
from shape_obs.image.region import Region
from shape_obs.image.sharing import CLOSE, share
from shape_obs.tracking.exchanges import exchange_gain
from shape_obs.tracking.predict import Fit, Prediction, Track
from shape_obs.tracking.scene import Scene
from shape_obs.tracking.scene_doubt import (
    TURN,
    changed_sides,
    claims_the_same,
    doubt_where_they_meet,
    doubtful_area,
    folds_anew,
    more_bent,
)

Array = npt.NDArray[np.float64]

DOUBTFUL: Final = 1.0  # squares of a width: less may speak against fits that are right
_EXCHANGED: Final = 20.0  # times the bend that an exchange of ends would save: what noise explains is taken off
_STEADY: Final = 0.3  # widths by which noise makes a rope longer or shorter
_GROWN: Final = 2.0  # squares of a width that a width more or less counts as: it may have taken over another rope's tip


class Attempt(NamedTuple):
    """A fit that the track has not followed yet."""

    found: Fit
    observed: Observed
    prediction: Prediction | None

    @property
    def width_in_image(self) -> float:
        """The width of the object that the fit assumed; under a cloud, that of its mask; pixels."""
        return self.found.object_width if self.observed.dimension == 2 else self.observed.parts[-1].width

    @property
    def is_found(self) -> bool:
        """Whether the object is seen, so that its track can follow it."""
        return not self.found.reason or self.found.follow

    @property
    def curve_in_image(self) -> FittedCurve | None:
        """The curve of a rope that is seen, pixels; None in space."""
        return self.found.form if self.is_found and self.found.form.points.shape[1] == 2 else None

    def refused(self, reason: str) -> Attempt:
        """Return the attempt without what was found."""
        return self._replace(found=Fit(reason=reason))


class Seen(NamedTuple):
    """A frame: the mask of all slots, their tracks, where each is expected, and where its nodes were last.

    ``ahead`` and ``last`` are ``(K, 2)`` pixels.
    """

    region: Region
    scene: Scene
    tracks: list[Track | None]
    expected: list[Prediction | None]
    ahead: list[Array | None]
    last: list[Array | None]


def doubt_of(seen: Seen, tries: list[Attempt | None], *, apart: bool = False) -> float:
    """Return what speaks against fits, in squares of a width: pixels of no rope, what was not seen, bends and lengths.

    A slot that was lost counts as much as its rope. What may well be, with a rope's ragged border, counts nothing.
    """
    shown = [each for each in tries if each is not None and each.found.form is not None and each.is_found]
    if not shown:
        return np.inf
    forms = [each.found for each in shown]
    widths = [found.object_width for found in forms]
    pixels = [each.width_in_image for each in shown]
    if apart:  # each has pieces of its own: what a curve leaves out of them its own fit has weighed
        beyond = max(seen.region.area - sum(each.observed.area for each in tries if each is not None), 0)
    else:
        curves = [in_image(found.form.points, seen.scene) for found in forms]
        beyond = share(seen.region, curves, pixels, CLOSE)[2]
    area = beyond / median(pixels) ** 2
    area += sum(doubtful_area(found.form, found.object_width) for found in forms) / median(widths) ** 2
    lost = sum(
        track.size / width
        for track, each, width in zip(seen.tracks, tries, cycle(widths), strict=False)
        if track is not None and each is not None and not each.is_found
    )
    bent = grown = 0.0
    for track, each in zip(seen.tracks, tries, strict=True):
        if each is not None and each.found.track is not None and track is not None and each.is_found:
            bent += more_bent(each.found.track.nodes, track.nodes, each.found.object_width)
            size = (each.found.form.points.shape[1] == 2 and track.length_in_image) or track.size
            grown += max(abs(each.found.size - size) / each.found.object_width - _STEADY, 0.0)
    if not apart:
        strands = [(found.form, found.object_width) for found in forms if found.form.points.shape[1] == 2]
        bent += _EXCHANGED * sum(
            exchange_gain(one, other, width) for (one, width), (other, _) in combinations(strands, 2)
        )
    grown = 0.0 if apart else grown  # the image's border may cut a rope that meets no other
    doubt = lost + _GROWN * grown + TURN * bent + area
    return doubt if doubt > DOUBTFUL else 0.0


def price_of(seen: Seen, tries: list[Attempt | None], doubt: float) -> float:
    """Return what speaks against fits, and how far they are from where the tracks go, in widths, or changed sides."""
    price = doubt + changes_of_sides(seen, tries)
    for each, ahead in zip(tries, seen.ahead, strict=True):
        if each is not None and ahead is not None and each.is_found and each.found.track is not None:
            step = in_image(each.found.track.nodes, seen.scene) - ahead
            price += float(np.sqrt(np.mean(np.sum(step * step, axis=1)))) / max(each.width_in_image, 1.0)
    return price


def changes_of_sides(seen: Seen, tries: list[Attempt | None]) -> int:
    """Return how many pairs of ropes have changed sides."""
    placed = [
        (last, in_image(each.found.track.nodes, seen.scene), each.width_in_image)
        for each, last in zip(tries, seen.last, strict=True)
        if each is not None and last is not None and each.is_found and each.found.track is not None
    ]
    return sum(
        changed_sides(before, other_before, after, other_after, width)
        for (before, after, width), (other_before, other_after, _) in combinations(placed, 2)
    )


def kept_apart(seen: Seen, tries: list[Attempt | None]) -> list[Attempt | None]:
    """Refuse what was found where another rope is expected, or turns sharply: a rope's own part may be hidden."""
    kept, forms = list(tries), [None if each is None else each.curve_in_image for each in tries]
    for k, (each, form, own) in enumerate(zip(tries, forms, seen.ahead, strict=True)):
        if each is None or form is None:
            continue
        width, reason = each.found.object_width, ""
        if own is not None:
            others = [j for j in range(len(tries)) if j != k]
            found = [curve.points for j in others if (curve := forms[j]) is not None]
            lost = [at for j in others if forms[j] is None and (at := seen.ahead[j]) is not None]
            reason = doubt_where_they_meet(form, own, lost, found, width)
        elif folds_anew(form, each.observed, width):
            reason = "what was found turns sharply where its axis does not"
        kept[k] = each.refused(reason) if reason else each
    for k, other in permutations(range(len(kept)), 2):  # one rope for each: of two, the one that is seen better
        each, second = kept[k], kept[other]
        if each is None or second is None or each.curve_in_image is None or second.curve_in_image is None:
            continue
        if claims_the_same(each.curve_in_image, second.curve_in_image, each.found.object_width):
            kept[k] = each.refused("what was found belongs to another rope")
    return kept


def in_image(nodes: Array, scene: Scene) -> Array:
    """Return ``(K, 2)`` pixels of nodes in pixels or metres."""
    if nodes.shape[1] == 2 or scene.intrinsics is None:
        return nodes
    return np.ascontiguousarray(scene.intrinsics.project(nodes))
