"""Tracker: one shape from frame to frame, from what was observed of it to its points."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from shape_obs.clustering.base import Clusterer
from shape_obs.config.detector_config import DetectorConfig
from shape_obs.configurations.anchors import anchor_pixel, anchor_point
from shape_obs.configurations.base import Configuration
from shape_obs.configurations.shape_points import shape_of
from shape_obs.geometry.crossings import Crossing
from shape_obs.geometry.observed import Observed
from shape_obs.shape import Shape
from shape_obs.tracking.missing import lost_shape
from shape_obs.tracking.predict import Fit, Prediction, Track
from shape_obs.tracking.register_chain import direction
from shape_obs.tracking.scene import Scene
from shape_obs.tracking.speed_gate import LARGER, WHOLE, Candidate, SpeedGate, is_as_large

Array = npt.NDArray[np.float64]


class Tracker:
    """Follow one shape.

    Args:
        spec: What the shape is, the detector's defaults filled in.
        config: The detector's arguments.

    Attributes:
        track: Where the shape was last; None before it is found.
        strand: Its curve in the image, ``(P, 2)`` pixels from point 0, and its width; None if it was not found in the
            last frame, or is no ribbon.
    """

    def __init__(self, spec: Configuration, config: DetectorConfig) -> None:
        self.spec, self._config = spec, config
        self.track: Track | None = None
        self.strand: tuple[Array, float] | None = None
        self._gone = False  # lost for longer than ``max_age``
        self._gate = SpeedGate(config.max_speed, spec.model)
        self._candidate: Candidate | None = None  # what is seen while the track finds nothing
        self._before, self._begun = self._candidate, -math.inf  # the same before this frame, and the frame's time
        self._kind: tuple[bool, tuple[int, int]] | None = None  # of the frames
        self._number = 0  # of the last track
        self._last: Shape | None = None
        self._seen_at = 0.0
        self._seen_area, self._area = 0, 0.0  # in the last frame, and of the object; pixels or points
        self._misplaced = False  # whether the points of the last frame lie off the object, which is in plain sight

    @property
    def trackers(self) -> tuple[Tracker, ...]:
        """The tracker itself."""
        return (self,)

    def expect(self, scene: Scene) -> Prediction | None:
        """Return what is known of the shape; None if it has no track."""
        kind = scene.in_2d, scene.size
        if self._kind != kind:
            # Pixels cannot be compared with metres, or with those of another size.
            self.track = self._last = self._candidate = None
            self._kind = kind
        if self.track is None:
            return None
        reach = self._gate.reach(self.track, scene)
        return Prediction(self.track, scene.clock.now, self.spec.model, self._gone, reach)

    def target(self, scene: Scene, *, again: bool = False) -> Array | None:
        """Return where point 0 belongs if the shape is to be numbered in this frame; None if its place is free.

        Raises:
            ValueError: The anchor cannot be resolved.
        """
        spec = self.spec
        if spec.anchor is None or not (again or self.track is None or self._gone or spec.order == "image"):
            return None
        return (anchor_pixel if scene.in_2d else anchor_point)(spec, scene.anchors, scene.frame.camera)

    def fit(self, observed: Observed, scene: Scene) -> Fit:
        """Fit the shape to what was observed, and advance its track."""
        prediction, target = self.expect(scene), self.target(scene)
        if observed.refusal:
            self._candidate = None
            return Fit(reason=observed.refusal)
        found = self.spec.fit(observed, prediction, target, scene)
        return self.accept(found, observed, prediction, target, scene, alone=True)

    def accept(
        self, found: Fit, observed: Observed, prediction: Prediction | None, target: Array | None, scene: Scene, *,
        alone: bool = False,
    ) -> Fit:  # fmt: skip
        """Advance the track to a fit, unless it is another object's; number its points.

        If ``alone``, all that was observed may be the object, also if it is not where the track expects it.
        """
        spec = self.spec
        if self.track is not None and prediction is not None:
            found = self._checked(found, observed, prediction, scene, alone and spec.is_ribbon)
        if found.track is not None and (not found.reason or found.follow):
            begins = found.new or self._gone
            self._number += self.track is None or (begins and not found.same)
            self._gone, self._candidate = False, None
            self.track = found.track.begun() if begins else found.track
        if not found.reason:
            if spec.order == "image":
                seen = observed.seen(found.form.points, target)
                found = found._replace(form=spec.apply_index_order(found.form, seen, target))
            if isinstance(self._config.clustering, Clusterer):
                from shape_obs.configurations.cluster_assignment import assign_centres  # the map needs none

                found = assign_centres(found, observed, spec, self._config.clustering)
        self._misplaced, self._seen_area = bool(found.reason) and self._is_misplaced(observed), observed.area
        return found

    def _checked(self, found: Fit, observed: Observed, expected: Prediction, scene: Scene, alone: bool) -> Fit:
        """Return a fit if the object can be there; else what is seen instead, once it is believed, or why not."""
        now, track = scene.clock.now, expected.track
        if self._begun != now:  # a frame is looked at twice, in a window and as a whole
            self._begun, self._before = now, self._candidate
        before = self._before
        if found.reason and found.size > LARGER * track.size:  # the fit lost its way, and the track would with it
            found = found._replace(follow=False)
        far = ""
        if not found.reason or found.follow:
            on_path = before is not None and before.leads_to(found, self._gate, scene)
            seconds = (before.begun if before is not None and on_path else now) - track.stamp
            assert found.track is not None
            far = self._gate.exceeded(found.track.nodes, expected, seconds, scene)
            if not far:
                return found
            if expected.lost and not (before is not None and before.joined):
                return self.spec.fit(observed, None, self.target(scene), scene)
        elif not alone:
            return found
        seen = self._candidate_in(found, observed, expected, scene)
        if before is None or self._candidate is None or not self._candidate.believed:
            return found._replace(reason=far or found.reason, follow=False)
        if self._candidate.joined:
            self.track, self._gone = before.track, False
            return seen
        fresh = Fit() if before.own else self.spec.fit(observed, None, self.target(scene, again=True), scene)
        return (seen if before.own or fresh.reason else fresh)._replace(new=True)

    def _candidate_in(self, found: Fit, observed: Observed, expected: Prediction, scene: Scene) -> Fit:
        """Follow the candidate, or begin another one with a fit that is out of reach, or cold; return its fit."""
        spec, gate, now, before, track = self.spec, self._gate, scene.clock.now, self._before, expected.track
        self._candidate = None
        if before is not None:
            seen = spec.fit(observed, Prediction(before.track, now, spec.model), None, scene)
            if seen.track is not None and before.leads_to(seen, gate, scene):
                self._candidate = before.continued(seen.track)
                if before.frames == 0:
                    joins = before.joins and gate.joins(self._candidate, before.track.nodes, expected, scene)
                    self._candidate = self._candidate._replace(joins=joins)
                return seen
        own = False
        if found.reason and not found.follow:
            if observed.area > LARGER * self._area:  # noise, or another object: no time is lost
                return found
            head = np.ascontiguousarray(track.nodes[:1])
            found = spec.fit(observed, None, observed.seen(head, head)[0], scene)
            if found.reason or found.track is None or not is_as_large(found, track, now):
                return found
            own = direction(found.track.nodes, track.nodes, expected.reach) <= 0
            found = spec.fit(observed, None, self.target(scene, again=True), scene) if own else found
        assert found.track is not None
        refused = 0 if before is None else before.refused + 1
        self._candidate = Candidate(found.track.begun(), now, 0, refused, not own, own)
        return found

    def _is_misplaced(self, observed: Observed) -> bool:
        """Return whether the points that are held lie off the object, though it seems to be in plain sight."""
        last = self._last
        points = None if last is None else last.points3d if observed.dimension == 3 else last.points2d
        if points is None or (observed.area < WHOLE * self._area and self._candidate is None):
            return False
        known = points[np.isfinite(points).all(axis=1)].astype(np.float64)
        return len(known) > 0 and float(np.mean(~observed.carries(known))) > self.spec.model.max_off

    def cross(self, shape: Shape, crossings: tuple[Crossing, ...]) -> Shape:
        """Return the shape that was found with its crossings, which it keeps while it is held."""
        self._last = replace(shape, crossings=crossings)
        return self._last

    @property
    def was_found(self) -> bool:
        """Whether the shape was found since the last reset."""
        return self._last is not None

    def is_held(self, scene: Scene) -> bool:
        """Return whether the shape was found at most ``max_age`` seconds ago."""
        return self._last is not None and scene.clock.now - self._seen_at <= self._config.max_age

    def finish(self, found: Fit, scene: Scene) -> Shape:
        """Turn a form into ordered points, in space if there is depth; or apply the policy for a lost shape."""
        spec, config, clock, last = self.spec, self._config, scene.clock, self._last
        self.strand = None
        misplaced, self._misplaced = self._misplaced, False
        if not (reason := found.reason):  # depth enters: -> points
            shape = shape_of(spec, found, scene, last, config.on_invalid, self._number)
            if not (reason := shape.reason):
                self._last, self._seen_at = shape, clock.now
                self._area = self._seen_area * len(shape) / max(np.count_nonzero(shape.visible), 1)
                if spec.is_ribbon and scene.in_2d:
                    points = found.form.points[::2]  # every half a width, which is fine enough to cross
                    points = points if points.shape[1] == 2 else shape.pixels.astype(np.float64)
                    assert found.track is not None
                    self.strand = np.ascontiguousarray(points), float(found.track.state["seen_width"][0])
                return shape
        age = clock.now - self._seen_at
        if last is not None and age > config.max_age and found.reason:  # else it is still tracked
            if not self._gone:
                clock.explain_loss(config.max_age)
            self._gone = True
            if not spec.resumes:
                self.track = None
        return lost_shape(
            spec.name, spec.layout, reason=f"{reason}; {clock.warning}" if clock.warning else reason,
            in_2d=scene.in_2d, in_3d=scene.in_3d, last=last, age=age, held=age <= config.max_age and not misplaced,
            policy=config.on_missing, diagonal=math.hypot(*scene.size),
        )  # fmt: skip
