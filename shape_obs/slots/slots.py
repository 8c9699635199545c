"""Slots: several objects of one kind in one mask, each of them followed by a tracker of its own."""

from __future__ import annotations

import math
from dataclasses import replace
from statistics import median
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.config.detector_config import DetectorConfig
from shape_obs.configurations.base import Configuration
from shape_obs.geometry.polyline import catmull_rom
from shape_obs.image.connected_runs import draw_components
from shape_obs.image.pieces import component_parts, split_components
from shape_obs.image.region import Region
from shape_obs.image.segmentation import Segmentation
from shape_obs.image.sharing import EXPECTED, FOUND, MOST, TRACED, WIDE, Reach, owned_runs, part_of, share, share_pixels
from shape_obs.initialization.appearance import middle_width
from shape_obs.initialization.pairing import first_chord
from shape_obs.initialization.strand_curves import sharp_turns
from shape_obs.shape import Shape
from shape_obs.slots.attempts import (
    DOUBTFUL,
    Attempt,
    Seen,
    changes_of_sides,
    doubt_of,
    in_image,
    kept_apart,
    price_of,
)  # fmt: skip
from shape_obs.slots.passages import Lying, Passages, better, change_of_headings, lying_of, moved
from shape_obs.tracker import Tracker
from shape_obs.tracking.exchanges import meetings
from shape_obs.tracking.predict import Fit
from shape_obs.tracking.scene import Scene
from shape_obs.tracking.scene_doubt import NEXT_TO, bending_energy, sides_of
from shape_obs.tracking.seats import add_pieces, distances, seat_others, seat_tracked
from shape_obs.tracking.state import LENGTH

Array = npt.NDArray[np.float64]

_PIECE: Final = 1.5  # widths: a piece of a rope that something cuts lies no farther from where the rope is expected
_FAR: Final = 0.1  # of the diagonal, in an interval: an object that is found farther from a track is another one
_PATIENCE: Final = 10  # frames between two searches for objects that do not come: these take longer than a frame

#: The compiled functions that slots may call.
SLOT_FUNCTIONS: Final = (
    share_pixels, split_components, owned_runs, draw_components, sides_of, bending_energy, sharp_turns, first_chord,
    meetings, middle_width, change_of_headings,
)  # fmt: skip
_NOTHING: Final = "no other object was found in the mask"


class Slots:
    """Follow several objects of one kind, which may lie over each other.

    Args:
        spec: What the objects are, and how many; the detector's defaults filled in.
        config: The detector's arguments.

    Attributes:
        trackers: One for each slot.
        more: How many objects were found in the last frame that have no slot.
    """

    trackers: list[Tracker]
    more: int

    def __init__(self, spec: Configuration, config: DetectorConfig) -> None:
        self.spec, self.more = spec, 0
        self.trackers = [Tracker(slot, config) for slot in spec.slots()]
        self._wait, self._doubt_before, self._bared = 0, 0.0, False
        self._passages, self._lying = Passages(), list[Lying | None]()

    def attempt(self, region: Region, scene: Scene) -> list[Attempt | None]:
        """Fit each slot to its part of a mask; None for a slot without one.

        The tracks stay as they are, unless two of them turn out to have been exchanged.
        """
        self._lying = []
        if region.refusal:
            return [Attempt(Fit(reason=region.refusal), region, None)] * len(self.trackers)
        if self._bared:  # there were connectors
            region, self._bared = self.spec.bare(region)
        seen = self._seen(region, scene)
        if not self.spec.is_ribbon or not any(seen.expected):
            return self._search(seen, [None] * len(self.trackers))
        tries, met = self._follow(seen, seen.ahead, EXPECTED)
        doubt = doubt_of(seen, tries, apart=not met)
        if met and (doubt > 0 or changes_of_sides(seen, tries)):
            # Ropes that run into each other stop; where they are expected, they may have changed places.
            both = zip(seen.last, seen.ahead, strict=True)
            halfway = [None if at is None or to is None else (at + to) / 2 for at, to in both]
            ways = [tries, *(self._follow(seen, nodes, WIDE)[0] for nodes in (seen.last, halfway))]
            doubts = [doubt, *(doubt_of(seen, each) for each in ways[1:])]
            best = int(np.argmin([price_of(seen, *each) for each in zip(ways, doubts, strict=True)]))
            tries, doubt = ways[best], doubts[best]
        if doubt > 0 and self._looks_again(doubt):
            found = self._search(seen, tries)
            doubt_found = doubt_of(seen, found)
            if price_of(seen, found, doubt_found) < price_of(seen, tries, doubt):
                tries, doubt = found, doubt_found
            else:
                self._wait = _PATIENCE
        return self._exchanged(seen, tries, doubt, met)

    def accept(self, tries: list[Attempt | None], scene: Scene) -> list[Shape]:
        """Advance the tracks to what was found, and return the shape of each slot.

        With ``count="all"`` slots that hold nothing are left out.
        """
        widths = [each.width_in_image for each in tries if each is not None and each.is_found]
        if widths and self._lying:
            self._passages.add(self._lying, median(widths))
        shapes = []
        for tracker, each in zip(self.trackers, tries, strict=True):
            found = Fit(reason=_NOTHING) if each is None else tracker.accept(*each, tracker.target(scene), scene)
            if each is not None or tracker.is_held(scene) or self.spec.count != "all":
                shapes.append(tracker.finish(found, scene))
        return shapes

    def _seen(self, region: Region, scene: Scene) -> Seen:
        """Return a frame, with where the tracks are and go."""
        expected = [tracker.expect(scene) for tracker in self.trackers]
        tracks = [tracker.track for tracker in self.trackers]
        ahead, last = ([each and in_image(each.nodes, scene) for each in row] for row in (expected, tracks))
        return Seen(region, scene, tracks, expected, ahead, last)

    def _exchanged(self, seen: Seen, tries: list[Attempt | None], doubt: float, met: list[int]) -> list[Attempt | None]:
        """Return better fits, with tracks exchanged, if ropes have changed places where they lay over each other."""
        self._lying = lying_of(seen, tries, met)
        for pair, strange in self._passages.doubtful(self._lying).items():
            trackers = [self.trackers[k] for k in pair]
            tracks, before = [seen.tracks[k] for k in pair], [self._passages.before(k) for k in pair]
            for tracker, own, other, lay in zip(trackers, tracks, tracks[::-1], before, strict=True):
                if own is not None and other is not None and lay is not None:
                    tracker.track = moved(own, other, lay)
            now = self._seen(seen.region, seen.scene)
            again, meet = self._follow(now, now.ahead, EXPECTED)
            ways = [again, self._search(now, again)]
            doubts = [doubt_of(now, each, apart=not meet) for each in ways]
            best = int(np.argmin(doubts))
            lying = lying_of(now, ways[best], met)
            if better(self._passages.strangeness(lying, pair), doubts[best], strange, doubt):
                seen, tries, doubt, self._lying = now, ways[best], doubts[best], lying
            else:
                self._passages.refuse(pair, strange)
                for tracker, track in zip(trackers, tracks, strict=True):
                    tracker.track = track
        return tries

    def _follow(self, seen: Seen, nodes: list[Array | None], how: Reach) -> tuple[list[Attempt | None], list[int]]:
        """Fit the slots that have a track to the parts of the mask around their nodes; return which ribbons met."""
        tries: list[Attempt | None] = [None] * len(self.trackers)
        known, curves, widths = [], [], []
        for k, (each, at) in enumerate(zip(seen.expected, nodes, strict=True)):
            if each is not None and at is not None:
                known.append(k)
                curves.append(_from_tip_to_tip(at))
                widths.append(each.track.width or seen.region.width)
        if not known:
            return tries, []
        floor = self.spec.segmentation or Segmentation
        if apart := component_parts(seen.region, curves, floor.min_area, floor.min_share):
            for k, part in zip(known, apart, strict=True):
                tries[k] = self._try(k, part, seen)
            return tries, []
        owners, contested, _ = share(seen.region, curves, widths, how)
        for at in np.flatnonzero(contested).tolist():  # each is first fitted to what is its own for certain
            again = self._try(known[at], self._part(seen.region, owners, [at]), seen, meets=True)
            if not again.found.reason:
                curves[at] = in_image(again.found.form.points, seen.scene)
        met = [known[at] for at in np.flatnonzero(contested).tolist()]
        owners, _, _ = share(seen.region, curves, widths, FOUND)
        for at, k in enumerate(known):
            tries[k] = self._try(k, self._part(seen.region, owners, [at]), seen, meets=k in met)
        return (kept_apart(seen, tries) if met else tries), met

    def _looks_again(self, doubt: float) -> bool:
        """Return whether all objects are to be found again: not for long where that brought nothing lately."""
        self._wait = 0 if abs(doubt - self._doubt_before) > DOUBTFUL else self._wait - 1
        self._doubt_before = doubt
        return self._wait <= 0

    def _search(self, seen: Seen, earlier: list[Attempt | None]) -> list[Attempt | None]:
        """Find all objects of the mask, and fit each slot to its own."""
        tries, (region, bared) = list(earlier), self.spec.bare(seen.region)
        self._bared |= bared  # what has none any more had some before
        every, reason = self.spec.find_objects(region, seen.scene.frame.rgb)
        objects = every[:MOST]  # the largest: pixels are shared among no more
        width = median(each.width for each in objects) if objects else 0.0
        far = _FAR * math.hypot(*seen.scene.size)
        # What was lost for long may be anywhere, but so may be what has come instead.
        reach = [
            0.0 if each is None else NEXT_TO * width if each.lost else far * each.intervals for each in seen.expected
        ]
        lengths = [(track is not None and track.length_in_image) or math.inf for track in seen.tracks]
        away = distances(objects, seen.ahead)
        seats = seat_tracked(objects, away, reach, lengths)
        free = [k for k, each in enumerate(seen.expected) if each is None or each.lost]
        targets = [tracker.target(seen.scene) for tracker in self.trackers]
        kept = np.flatnonzero((away[0] <= NEXT_TO * width).any(axis=0)).tolist()
        seats = seat_others(
            objects, seats, targets, sorted(free, key=lambda k: self.trackers[k].track is not None), kept
        )
        self.more = len(every) - sum(at >= 0 for at in seats)
        shared = [at for at, each in enumerate(objects) if each.region is None]
        curves, widths = [objects[at].curve.points for at in shared], [objects[at].width for at in shared]
        owners = share(region, curves, widths, TRACED)[0] if shared else None
        reach = _PIECE * median(widths) if shared else 0.0
        for k, pieces in enumerate(add_pieces(seats, away[0], reach)):
            if pieces:
                part = objects[pieces[0]].region
                if part is None:
                    part = self._part(region, owners, [shared.index(at) for at in pieces])
                    part = part if len(pieces) > 1 else replace(part, axis=objects[pieces[0]].curve)
                tries[k] = self._try(k, part, seen, meets=objects[pieces[0]].region is None)
            elif tries[k] is None and not objects:
                tries[k] = Attempt(Fit(reason=reason), region, None)
        return kept_apart(seen, tries) if self.spec.is_ribbon else tries

    def _part(self, region: Region, owners: Any, ribbons: list[int]) -> Region:
        """Return the part of a mask that belongs to some of the ribbons."""
        floor = self.spec.segmentation or Segmentation
        return part_of(region, owners, ribbons, floor.min_area, floor.min_share)

    def _try(self, k: int, part: Region, seen: Seen, *, meets: bool = False) -> Attempt:
        """Fit one slot to its part of the mask; a rope that meets another one keeps the length that was known."""
        tracker, observed, scene = self.trackers[k], part, seen.scene
        if self.spec.lift == "cloud":
            from shape_obs.point_cloud.deprojection import deproject  # most detectors see no clouds

            assert scene.depth is not None
            assert scene.intrinsics is not None
            observed = deproject(part, scene.depth, scene.intrinsics)
        prediction = tracker.expect(scene)
        if part.refusal:
            return Attempt(Fit(reason=part.refusal), observed, prediction)
        found = tracker.spec.fit(observed, prediction, tracker.target(seen.scene), scene)
        known = None if prediction is None else prediction.track.rope
        if meets and known is not None and known["frames"][0] > 0 and found.track is not None:
            found.track.state[LENGTH] = known[LENGTH]
        return Attempt(found, observed, prediction)


def _from_tip_to_tip(nodes: Array) -> Array:
    """Return a smooth curve through nodes, which are the middles of equal pieces, to both ends of the pieces."""
    tips = 1.5 * nodes[[0, -1]] - 0.5 * nodes[[1, -2]]
    return catmull_rom(np.concatenate([tips[:1], nodes, tips[1:]]), 4, False)
