"""Tracker: one shape from frame to frame, from what was observed of it to its points."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.clustering.base import Clusterer
from shape_obs.config.detector_config import DetectorConfig
from shape_obs.configurations.anchors import Anchors, anchor_pixel, anchor_point
from shape_obs.configurations.base import Configuration, Scene
from shape_obs.configurations.shape_points import shape_of
from shape_obs.frame import Frame
from shape_obs.geometry.crossings import Crossing
from shape_obs.geometry.observed import Observed
from shape_obs.shape import Shape
from shape_obs.tracking.clock import Clock
from shape_obs.tracking.missing import lost_shape
from shape_obs.tracking.prediction import Fit, Prediction, Reach, Track, advance, predict

Array = npt.NDArray[np.float64]


class Moment(NamedTuple):
    """A frame on its way.

    Args:
        frame: The images.
        clock: The time now.
        anchors: Name -> pixel (u, v) or base-frame point (x, y, z).
        timings: Milliseconds by stage.
        in_2d: Whether points get pixels.
        in_3d: Whether points get metres.
        size: ``(H, W)`` in pixels; zeros for a cloud.
    """

    frame: Frame
    clock: Clock
    anchors: Anchors
    timings: dict[str, float]
    in_2d: bool
    in_3d: bool
    size: tuple[int, int] = (0, 0)


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
        self._reach = Reach(config.max_speed)
        self._kind: tuple[type[Observed], tuple[int, int]] | None = None
        self._number = 0  # of the last track
        self._last: Shape | None = None
        self._seen_at = 0.0

    @property
    def trackers(self) -> tuple[Tracker, ...]:
        """The tracker itself."""
        return (self,)

    def expect(self, observed: Observed, moment: Moment) -> Prediction | None:
        """Return where the shape should be; None if it is unknown."""
        kind = type(observed), moment.size
        if self._kind is not None and self._kind != kind:
            self.track = self._last = None  # pixels cannot be compared with metres, or those of another size
        self._kind = kind
        return self.foresee(observed, moment)

    def foresee(self, observed: Observed, moment: Moment) -> Prediction | None:
        """Return where the track goes, whatever the shape was observed as; None without a track."""
        return predict(self.track, observed, moment.clock.now, self._gone)

    def target(self, moment: Moment) -> Array | None:
        """Return where point 0 belongs if the shape is to be numbered in this frame; None if its place is free.

        Raises:
            ValueError: The anchor cannot be resolved.
        """
        spec = self.spec
        if spec.anchor is None or not (self.track is None or self._gone or spec.order == "image"):
            return None
        return (anchor_pixel if moment.in_2d else anchor_point)(spec, moment.anchors, moment.frame.camera)

    def fit(self, observed: Observed, moment: Moment, scene: Scene) -> Fit:
        """Fit the shape to what was observed, and advance its track."""
        prediction, target = self.expect(observed, moment), self.target(moment)
        if observed.refusal:
            return Fit(reason=observed.refusal)
        found = self.spec.fit(observed, prediction, target, scene)
        return self.accept(found, observed, prediction, target, moment, scene)

    def accept(
        self,
        found: Fit,
        observed: Observed,
        prediction: Prediction | None,
        target: Array | None,
        moment: Moment,
        scene: Scene,
    ) -> Fit:
        """Advance the track to a fit, unless it is another object's; number its points."""
        spec, now = self.spec, moment.clock.now
        if self.track is not None and prediction is not None and (not found.reason or found.follow):
            view = scene.images, 0.0 if scene.intrinsics is None else scene.intrinsics.fx
            if far := self._reach.exceeded(spec.name, self.track, found, now, view, moment.size[1]):
                found = spec.fit(observed, None, target, scene) if prediction.stale else Fit(reason=far)
        if not found.reason or found.follow:
            track = None if found.new or self._gone else self.track
            self._gone = False
            self._number = self._number + 1 if track is None else track.track_id
            found = found._replace(track_id=self._number)
            self.track = advance(track, found, observed, now)
        if not found.reason:
            if spec.order == "image":
                seen = observed.seen(found.form.points, target)
                found = found._replace(form=spec.apply_index_order(found.form, seen, target), laid=None)
            if isinstance(self._config.clustering, Clusterer):
                from shape_obs.configurations.cluster_assignment import assign_centres  # the map needs none

                found = assign_centres(found, observed, spec, self._config.clustering)
        return found

    def cross(self, shape: Shape, crossings: tuple[Crossing, ...]) -> Shape:
        """Return the shape that was found with its crossings, which it keeps while it is held."""
        self._last = replace(shape, crossings=crossings)
        return self._last

    @property
    def was_found(self) -> bool:
        """Whether the shape was found since the last reset."""
        return self._last is not None

    def is_held(self, moment: Moment) -> bool:
        """Return whether the shape was found at most ``max_age`` seconds ago."""
        return self._last is not None and moment.clock.now - self._seen_at <= self._config.max_age

    def finish(self, found: Fit, moment: Moment) -> Shape:
        """Turn a form into ordered points, in space if there is depth; or apply the policy for a lost shape."""
        spec, config, clock, last = self.spec, self._config, moment.clock, self._last
        self.strand = None
        diagonal = math.hypot(*moment.size)
        if not (reason := found.reason):  # depth enters: -> points
            shape = shape_of(spec, found, moment.frame, last, config.on_invalid, diagonal)
            if not (reason := shape.reason):
                self._last, self._seen_at = shape, clock.now
                if spec.is_ribbon and moment.in_2d:
                    points = found.form.points[::2]  # every half a width, which is fine enough to cross
                    points = points if points.shape[1] == 2 else shape.pixels.astype(np.float64)
                    self.strand = np.ascontiguousarray(points), found.width
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
            in_2d=moment.in_2d, in_3d=moment.in_3d, last=last, age=age,
            max_age=config.max_age, policy=config.on_missing, diagonal=diagonal,
        )  # fmt: skip
