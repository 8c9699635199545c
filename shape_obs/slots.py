"""Slots: several objects of one kind in one mask, each of them followed by a tracker of its own."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations, cycle
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.config.detector_config import DetectorConfig
from shape_obs.configurations.base import Configuration, Scene
from shape_obs.geometry.observed import Observed
from shape_obs.geometry.polyline import catmull_rom
from shape_obs.image.pieces import component_parts
from shape_obs.image.region import Region
from shape_obs.image.segmentation import Segmentation
from shape_obs.image.sharing import CLOSE, EXPECTED, FOUND, MOST, TRACED, WIDE, Reach, part_of, share
from shape_obs.shape import Shape
from shape_obs.tracker import Moment, Tracker
from shape_obs.tracking.exchanges import exchange_gain
from shape_obs.tracking.prediction import Fit, Prediction
from shape_obs.tracking.scene_doubt import changed_sides, doubt_where_they_meet, doubtful_area, folds_anew, more_bent
from shape_obs.tracking.seats import add_pieces, near_tracks, seat_others, seat_tracked

Array = npt.NDArray[np.float64]

_DOUBTFUL: Final = 1.0  # squares of a width: less may speak against fits that are right
_EXCHANGED: Final = 20.0  # of bending energy that an exchange of ends would save
_BENDING: Final = 3.0  # squares of a width that a unit of bending energy counts as: a kink of 40 degrees has a third
_PIECE: Final = 1.5  # widths: a piece of a rope that something cuts lies no farther from where the rope is expected
_KEPT: Final = 4.0  # widths: what lies on average so near to where a rope is expected is no new one
_CHANGED_SIDES: Final = 1.0  # what it costs that two ropes change sides, in widths of RMS distance from the tracks
_FAR: Final = 0.1  # of the diagonal, in an interval: an object that is found farther from a track is another one
_LAPSE: Final = 5.0  # intervals without an object after which it is expected no farther away
_PATIENCE: Final = 10  # frames between two searches for objects that do not come
_NOTHING: Final = "no other object was found in the mask"


class Attempt(NamedTuple):
    """A fit that the track has not followed yet."""

    found: Fit
    observed: Observed
    prediction: Prediction | None

    @property
    def is_found(self) -> bool:
        """Whether the object is seen, so that its track can follow it."""
        return not self.found.reason or self.found.follow


class _Seen(NamedTuple):
    """A frame: the mask of all slots, where each is expected, and where its nodes were last, ``(K, 2)`` pixels."""

    region: Region
    moment: Moment
    scene: Scene
    expected: list[Prediction | None]
    last: list[Array | None]


class Slots:
    """Follow several objects of one kind, which may lie over each other.

    Args:
        spec: What the objects are, and how many; the detector's defaults filled in.
        config: The detector's arguments.

    Attributes:
        trackers: One for each slot.
        more: How many objects were found in the last frame that have no slot.
    """

    def __init__(self, spec: Configuration, config: DetectorConfig) -> None:
        self.spec, self.more = spec, 0
        self.trackers = [Tracker(slot, config) for slot in spec.slots()]
        self._wait, self._doubt_before, self._bared = 0, 0.0, False

    def attempt(self, region: Region, moment: Moment, scene: Scene) -> list[Attempt | None]:
        """Fit each slot to its part of a mask; None for a slot without one. The tracks stay as they are."""
        if region.refusal:
            return [Attempt(Fit(reason=region.refusal), region, None)] * len(self.trackers)
        if self._bared:  # the last search found connectors
            region = self.spec.bare(region)[0]
        expected = [tracker.foresee(region, moment) for tracker in self.trackers]
        last = [None if tracker.track is None else _in_image(tracker.track.nodes, scene) for tracker in self.trackers]
        seen = _Seen(region, moment, scene, expected, last)
        if not self.spec.is_ribbon or not any(expected):
            return self._search(seen, [None] * len(self.trackers))
        ahead = [None if each is None else _in_image(each.nodes, scene) for each in expected]
        tries, met = self._follow(seen, ahead, EXPECTED)
        doubt = self._doubt(region, tries, apart=not met)
        if met and (doubt > 0 or self._changes(seen, tries)):
            # Ropes that run into each other stop; where they are expected, they may have changed places.
            both = zip(last, ahead, strict=True)
            halfway = [None if at is None or to is None else (at + to) / 2 for at, to in both]
            ways = [tries, *(self._follow(seen, nodes, WIDE)[0] for nodes in (last, halfway))]
            doubts = [doubt, *(self._doubt(region, each) for each in ways[1:])]
            best = int(np.argmin([self._price(seen, *each) for each in zip(ways, doubts, strict=True)]))
            tries, doubt = ways[best], doubts[best]
        if doubt > 0 and self._looks_again(doubt):
            found = self._search(seen, tries)
            if self._price(seen, found, self._doubt(region, found)) < self._price(seen, tries, doubt):
                return found
            self._wait = _PATIENCE
        return tries

    def accept(self, tries: list[Attempt | None], moment: Moment, scene: Scene) -> list[Shape]:
        """Advance the tracks to what was found, and return the shape of each slot.

        With ``count="all"`` slots that hold nothing are left out.
        """
        shapes = []
        for tracker, each in zip(self.trackers, tries, strict=True):
            if each is None:
                found = Fit(reason=_NOTHING)
            else:
                found = tracker.accept(*each, tracker.target(moment), moment, scene)
            if each is not None or tracker.is_held(moment) or self.spec.count != "all":
                shapes.append(tracker.finish(found, moment))
        return shapes

    def _follow(self, seen: _Seen, nodes: list[Array | None], how: Reach) -> tuple[list[Attempt | None], bool]:
        """Fit the slots that have a track to the parts of the mask around their nodes; return whether ribbons met."""
        tries: list[Attempt | None] = [None] * len(self.trackers)
        known, curves, widths = [], [], []
        for k, (each, at) in enumerate(zip(seen.expected, nodes, strict=True)):
            if each is not None and at is not None:
                known.append(k)
                curves.append(catmull_rom(at, 4, False))
                widths.append(each.width or seen.region.width)
        if not known:
            return tries, False
        floor = self.spec.segmentation or Segmentation
        if apart := component_parts(seen.region, curves, floor.min_area, floor.min_share):
            for k, part in zip(known, apart[0], strict=True):
                tries[k] = self._try(k, part, seen)
            return tries, False
        owners, contested, _ = share(seen.region, curves, widths, how)
        # Where ribbons meet, each is first fitted to what is its own for certain.
        for at in np.flatnonzero(contested).tolist():
            again = self._try(known[at], self._part(seen.region, owners, [at]), seen)
            if not again.found.reason:
                curves[at] = again.found.form.points
        met = bool(contested.any())
        owners, _, _ = share(seen.region, curves, widths, FOUND)
        for at, k in enumerate(known):
            tries[k] = self._try(k, self._part(seen.region, owners, [at]), seen)
        return (self._kept_apart(seen, tries) if met else tries), met

    def _kept_apart(self, seen: _Seen, tries: list[Attempt | None]) -> list[Attempt | None]:
        """Refuse what was found where another rope is expected, or turns sharply: its own part may be hidden."""
        ahead = [None if each is None else _in_image(each.nodes, seen.scene) for each in seen.expected]
        kept = list(tries)
        for k, each in enumerate(tries):
            own = ahead[k]
            if each is None or not each.is_found or each.found.form.points.shape[1] != 2:
                continue
            form, lost, found = each.found.form, [], []
            if own is None and folds_anew(form, each.observed, each.found.object_width):
                kept[k] = each._replace(found=Fit(reason="what was found turns sharply where its axis does not"))
            if own is None:
                continue
            for j, other in enumerate(tries):
                if j != k and other is not None and other.is_found and other.found.form.points.shape[1] == 2:
                    found.append(other.found.form.points)
                elif j != k and ahead[j] is not None:
                    lost.append(ahead[j])
            if reason := doubt_where_they_meet(form, own, lost, found, each.found.object_width):
                kept[k] = each._replace(found=Fit(reason=reason))
        return kept

    def _price(self, seen: _Seen, tries: list[Attempt | None], doubt: float) -> float:
        """Return what speaks against fits, with how far they are from where the tracks go, and changes of sides."""
        price = doubt + _CHANGED_SIDES * self._changes(seen, tries)
        for each, ahead in zip(tries, seen.expected, strict=True):
            if each is not None and ahead is not None and each.is_found and each.found.nodes is not None:
                step = _in_image(each.found.nodes, seen.scene) - _in_image(ahead.nodes, seen.scene)
                price += float(np.sqrt(np.mean(np.sum(step * step, axis=1)))) / max(each.found.object_width, 1.0)
        return price

    def _changes(self, seen: _Seen, tries: list[Attempt | None]) -> int:
        """Return how many pairs of ropes have changed sides."""
        placed = [
            (last, _in_image(each.found.nodes, seen.scene), each.found.object_width)
            for each, last in zip(tries, seen.last, strict=True)
            if each is not None and last is not None and each.is_found and each.found.nodes is not None
        ]
        return sum(
            changed_sides(before, other_before, after, other_after, width)
            for (before, after, width), (other_before, other_after, _) in combinations(placed, 2)
        )

    def _doubt(self, region: Region, tries: list[Attempt | None], *, apart: bool = False) -> float:
        """Return what speaks against fits, in squares of a width: pixels of no rope, what was not seen, new bends.

        A slot that was lost counts as much as its rope. What may well be, with a rope's ragged border, counts nothing.
        """
        forms = [each.found for each in tries if each is not None and each.found.form is not None and each.is_found]
        if not forms:
            return np.inf
        widths = [found.object_width for found in forms]
        if apart:  # each has pieces of its own: what a curve leaves out of them its own fit has weighed
            beyond = max(region.area - sum(each.observed.area for each in tries if each is not None), 0)
        else:
            beyond = share(region, [found.form.points for found in forms], widths, CLOSE)[2]
        area = beyond + sum(doubtful_area(found.form, found.object_width) for found in forms)
        lost = sum(
            tracker.track.size / width
            for tracker, each, width in zip(self.trackers, tries, cycle(widths), strict=False)
            if tracker.track is not None and each is not None and not each.is_found
        )
        bent = 0.0
        for tracker, each in zip(self.trackers, tries, strict=True):
            if each is not None and each.found.nodes is not None and tracker.track is not None and each.is_found:
                bent += more_bent(each.found.nodes, tracker.track.nodes, each.found.object_width)
        if not apart:
            strands = [(found.form, found.object_width) for found in forms if found.form.points.shape[1] == 2]
            bent += _EXCHANGED * sum(
                exchange_gain(one, other, width) for (one, width), (other, _) in combinations(strands, 2)
            )
        doubt = lost + _BENDING * bent + area / float(np.median(widths)) ** 2
        return doubt if doubt > _DOUBTFUL else 0.0

    def _looks_again(self, doubt: float) -> bool:
        """Return whether all objects are to be found again: not for long where that brought nothing lately."""
        self._wait = 0 if abs(doubt - self._doubt_before) > _DOUBTFUL else self._wait - 1
        self._doubt_before = doubt
        return self._wait <= 0

    def _search(self, seen: _Seen, earlier: list[Attempt | None]) -> list[Attempt | None]:
        """Find all objects of the mask, and fit each slot to its own."""
        tries, (region, self._bared) = list(earlier), self.spec.bare(seen.region)
        every, reason = self.spec.find_objects(region, seen.moment.frame.rgb)
        objects = every[:MOST]  # the largest: pixels are shared among no more
        ahead = [None if each is None else _in_image(each.nodes, seen.scene) for each in seen.expected]
        width = float(np.median([each.width for each in objects])) if objects else 0.0
        far = _FAR * math.hypot(*seen.moment.size)
        # What was lost for long may be anywhere, but so may be what has come instead.
        reach = [
            0.0 if each is None else _KEPT * width if each.stale else far * min(each.lapse, _LAPSE)
            for each in seen.expected
        ]
        seats, targets = seat_tracked(objects, ahead, reach), [each.target(seen.moment) for each in self.trackers]
        free = [k for k, each in enumerate(seen.expected) if each is None or each.stale]
        free.sort(key=lambda k: self.trackers[k].track is not None)
        kept = near_tracks(objects, ahead, _KEPT * width) if objects else ()
        seats = seat_others(objects, seats, targets, free, kept)
        self.more = len(every) - sum(at >= 0 for at in seats)
        shared = [at for at, each in enumerate(objects) if each.region is None]
        curves, widths = [objects[at].curve.points for at in shared], [objects[at].width for at in shared]
        owners = share(region, curves, widths, TRACED)[0] if shared else None
        reach = _PIECE * float(np.median(widths)) if shared else 0.0
        for k, pieces in enumerate(add_pieces(objects, seats, ahead, reach)):
            if pieces:
                part = objects[pieces[0]].region
                if part is None:
                    part = self._part(region, owners, [shared.index(at) for at in pieces])
                    part = part if len(pieces) > 1 else replace(part, axis=objects[pieces[0]].curve)
                tries[k] = self._try(k, part, seen)
            elif tries[k] is None and not objects:
                tries[k] = Attempt(Fit(reason=reason), region, None)
        return self._kept_apart(seen, tries) if self.spec.is_ribbon else tries

    def _part(self, region: Region, owners: Any, ribbons: list[int]) -> Region:
        """Return the part of a mask that belongs to some of the ribbons."""
        floor = self.spec.segmentation or Segmentation
        return part_of(region, owners, ribbons, floor.min_area, floor.min_share)

    def _try(self, k: int, part: Region, seen: _Seen) -> Attempt:
        """Fit one slot to its part of the mask."""
        tracker, observed, scene = self.trackers[k], part, seen.scene
        if self.spec.lift == "cloud":
            from shape_obs.point_cloud.deprojection import deproject  # most detectors see no clouds

            assert scene.depth is not None
            assert scene.intrinsics is not None
            observed = deproject(part, scene.depth, scene.intrinsics)
        prediction = tracker.expect(observed, seen.moment)
        if part.refusal:
            return Attempt(Fit(reason=part.refusal), observed, prediction)
        return Attempt(tracker.spec.fit(observed, prediction, tracker.target(seen.moment), scene), observed, prediction)


def _in_image(nodes: Array, scene: Scene) -> Array:
    """Return ``(K, 2)`` pixels of nodes in pixels or metres."""
    if nodes.shape[1] == 2 or scene.intrinsics is None:
        return nodes
    return np.ascontiguousarray(scene.intrinsics.project(nodes))
