"""Slots: several objects of one kind in one mask, each of them followed by a tracker of its own."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import cycle
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.config.detector_config import DetectorConfig
from shape_obs.configurations.base import Configuration, Scene
from shape_obs.geometry.observed import Observed
from shape_obs.geometry.polyline import catmull_rom
from shape_obs.image.region import Region
from shape_obs.image.segmentation import Segmentation
from shape_obs.image.sharing import part_of, share_pixels
from shape_obs.shape import Shape
from shape_obs.tracker import Moment, Tracker
from shape_obs.tracking.prediction import Fit, Prediction
from shape_obs.tracking.scene_doubt import doubtful_area
from shape_obs.tracking.seats import seat_others, seat_tracked

Array = npt.NDArray[np.float64]

# Where ribbons are expected, and where they were found.
_EXPECTED, _FOUND, _APART, _CLOSE = 0, 1, 2, 3
# Pixels: what a ribbon claims around itself in a mask that holds others too, and how much farther a
# second ribbon may be from a pixel that both claim.
_REACH: Final = (6.0, 3.0, 6.0, 1.5)
_SLACK: Final = (1.0, 0.5, -3.0, 0.5)
_RAGGED: Final = 0.75  # pixels that the border of a ribbon may stick out
_DOUBTFUL: Final = 1.0  # squares of a width: less may speak against fits that are right
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
        self._wait, self._doubt_before = 0, 0.0

    def attempt(self, region: Region, moment: Moment, scene: Scene) -> list[Attempt | None]:
        """Fit each slot to its part of a mask; None for a slot without one. The tracks stay as they are."""
        if region.refusal:
            return [Attempt(Fit(reason=region.refusal), region, None)] * len(self.trackers)
        targets = [tracker.target(moment) for tracker in self.trackers]
        expected = [tracker.foresee(region, moment) for tracker in self.trackers]
        nodes = [None if each is None else _in_image(each.nodes, scene) for each in expected]
        tries: list[Attempt | None] = [None] * len(self.trackers)
        doubt = np.inf
        if self.spec.is_ribbon:
            self._follow(region, expected, nodes, tries, moment, scene)
            doubt = self._doubt(region, tries)
        if doubt > 0 and self._looks_again(tries, doubt):
            found = list(tries)
            self._search(region, expected, nodes, targets, found, moment, scene)
            if not self.spec.is_ribbon or self._doubt(region, found) < doubt:
                return found
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

    def _follow(
        self,
        region: Region,
        expected: list[Prediction | None],
        nodes: list[Array | None],
        tries: list[Attempt | None],
        moment: Moment,
        scene: Scene,
    ) -> None:
        """Fit the slots that have a track to the parts of the mask around their predictions."""
        known, curves, widths = [], [], []
        for k, (each, at) in enumerate(zip(expected, nodes, strict=True)):
            if each is not None and at is not None and not each.stale:
                known.append(k)
                curves.append(catmull_rom(at, 4, False))
                widths.append(each.width or region.width)
        if not known:
            return
        owners, contested, _ = _owners(region, curves, widths, _APART)
        for at in np.flatnonzero(contested):  # where ribbons meet, each is first fitted to what is its own for certain
            again = self._try(known[at], self._part(region, owners, at), moment, scene)
            if not again.found.reason:
                curves[at] = again.found.form.points
        owners, _, _ = _owners(region, curves, widths, _FOUND if contested.any() else _EXPECTED, spread=True)
        for at, k in enumerate(known):
            tries[k] = self._try(k, self._part(region, owners, at), moment, scene)

    def _doubt(self, region: Region, tries: list[Attempt | None]) -> float:
        """Return what speaks against fits, in squares of a width: pixels of no rope, what was not seen, sharp turns.

        A slot that was lost counts as much as its rope. What may well be, with a rope's ragged border, counts nothing.
        """
        forms = [each.found for each in tries if each is not None and each.found.form is not None and each.is_found]
        if not forms:
            return np.inf
        widths = [found.object_width for found in forms]
        beyond = _owners(region, [found.form.points for found in forms], widths, _CLOSE)[2]
        area = beyond + sum(doubtful_area(found.form, found.object_width) for found in forms)
        lost = sum(
            tracker.track.size / width
            for tracker, each, width in zip(self.trackers, tries, cycle(widths), strict=False)
            if tracker.track is not None and each is not None and not each.is_found
        )
        doubt = lost + area / float(np.median(widths)) ** 2
        return doubt if doubt > _DOUBTFUL else 0.0

    def _looks_again(self, tries: list[Attempt | None], doubt: float) -> bool:
        """Return whether all objects are to be found again: not for long where that brought nothing lately."""
        self._wait = 0 if abs(doubt - self._doubt_before) > _DOUBTFUL else self._wait - 1
        self._doubt_before = doubt
        return self._wait <= 0

    def _search(
        self,
        region: Region,
        expected: list[Prediction | None],
        nodes: list[Array | None],
        targets: list[Array | None],
        tries: list[Attempt | None],
        moment: Moment,
        scene: Scene,
    ) -> None:
        """Find all objects of the mask, and fit the slots that were not found to theirs."""
        objects, reason = self.spec.find_objects(region)
        lapse = max((each.lapse for each in expected if each is not None), default=1.0)
        seats = seat_tracked(objects, nodes, _FAR * math.hypot(*moment.size) * min(lapse, _LAPSE))
        free = sorted((k for k, each in enumerate(expected) if each is None or each.stale), key=self._was_used)
        seats = seat_others(objects, seats, targets, free)
        self.more = len(objects) - sum(at >= 0 for at in seats)
        self._wait = _PATIENCE
        shared = [at for at, each in enumerate(objects) if each.region is None]
        curves, widths = [objects[at].curve.points for at in shared], [objects[at].width for at in shared]
        owners = _owners(region, curves, widths, _FOUND, spread=True)[0] if shared else None
        for k, at in enumerate(seats):
            if at >= 0:
                part = objects[at].region
                if part is None:
                    part = replace(self._part(region, owners, shared.index(at)), axis=objects[at].curve)
                tries[k] = self._try(k, part, moment, scene)
            elif tries[k] is None and not objects:
                tries[k] = Attempt(Fit(reason=reason), region, None)

    def _was_used(self, k: int) -> bool:
        return self.trackers[k].track is not None

    def _part(self, region: Region, owners: Any, at: int) -> Region:
        """Return the part of a mask that belongs to one ribbon."""
        floor = self.spec.segmentation or Segmentation
        return part_of(region, owners, at, floor.min_area, floor.min_share)

    def _try(self, k: int, part: Region, moment: Moment, scene: Scene) -> Attempt:
        """Fit one slot to its part of the mask."""
        tracker, observed = self.trackers[k], part
        if self.spec.lift == "cloud":
            from shape_obs.point_cloud.deprojection import deproject  # most detectors see no clouds

            assert scene.depth is not None
            assert scene.intrinsics is not None
            observed = deproject(part, scene.depth, scene.intrinsics)
        prediction = tracker.expect(observed, moment)
        if part.refusal:
            return Attempt(Fit(reason=part.refusal), observed, prediction)
        return Attempt(tracker.spec.fit(observed, prediction, tracker.target(moment), scene), observed, prediction)


def _in_image(nodes: Array, scene: Scene) -> Array:
    """Return ``(K, 2)`` pixels of nodes in pixels or metres."""
    if nodes.shape[1] == 2 or scene.intrinsics is None:
        return nodes
    return np.ascontiguousarray(scene.intrinsics.project(nodes))


def _owners(
    region: Region, curves: list[Array], widths: list[float], when: int, *, spread: bool = False
) -> tuple[Any, Any, int]:
    """Share the pixels of a mask among ribbons."""
    radius = np.array(widths) / 2 + _RAGGED
    left, top, *_ = region.window
    points, stops = np.ascontiguousarray(np.concatenate(curves)), np.cumsum([len(curve) for curve in curves])
    return share_pixels(region.mask, left, top, points, stops, radius, _REACH[when], _SLACK[when], spread)
