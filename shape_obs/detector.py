"""ShapeDetector: the way of a frame, from images to ordered points.

image -> region -> initial form or prediction -> self-organising map -> matched to the track -> validated -> lifted.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping
from importlib import import_module
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraModel, Intrinsics, as_camera_model
from shape_obs.clustering.base import Clusterer
from shape_obs.compiled import compile_now
from shape_obs.config.detector_config import DetectorConfig
from shape_obs.configurations.anchors import Anchors, anchor_pixel, anchor_point
from shape_obs.configurations.base import Configuration, Scene
from shape_obs.configurations.shape_points import SHAPE_FUNCTIONS, shape_of
from shape_obs.frame import Frame, check_mask
from shape_obs.geometry.observed import Observed
from shape_obs.image.find_region import prepare
from shape_obs.image.roi import ROI
from shape_obs.image.segmentation import Segmentation
from shape_obs.shape import Detection, Shape
from shape_obs.tracking.missing import Clock, lost_shape
from shape_obs.tracking.prediction import TRACK_FUNCTIONS, Fit, Reach, Track, advance, predict
from shape_obs.tracking.search_window import RegionSearch
from shape_obs.utils.threads import use_no_threads_in_forked_children

Array = npt.NDArray[np.float64]
ShapeLike = Configuration | Mapping[str, Any] | str

_SEARCH_ALL: Final = 30  # frames, after which all of the image is searched: what was hidden may be back

use_no_threads_in_forked_children()


class _Moment(NamedTuple):
    """A frame on its way: images, milliseconds by stage, whether points get pixels and metres, and (H, W) in pixels."""

    frame: Frame
    timings: dict[str, float]
    in_2d: bool
    in_3d: bool
    size: tuple[int, int] = (0, 0)


class ShapeDetector:
    """Find shapes in frames and keep the index of their points from one frame to the next.

    Args:
        shapes: Configurations, as specs, mappings or names: ``[Centerline(n=20)]``, ``["centerline"]``.
        segmentation: The pixel rule, as a spec or a mapping; not needed for ``detect_mask``.
        options: The other fields of ``DetectorConfig``.

    Attributes:
        config: The arguments, as one spec.
        shapes: The configurations, the detector's defaults filled in.

    Raises:
        SpecError: An argument is not understood; the message names the nearest valid one.

    Example:
        >>> detector = ShapeDetector([Centerline(n=20)], HSVRange(low=(90, 60, 30), high=(130, 255, 255)))
        >>> shape = detector.detect(rgb, depth, intrinsics).shapes[0]  # doctest: +SKIP
        >>> shape.points3d.shape  # doctest: +SKIP
        (20, 3)
    """

    def __init__(
        self,
        shapes: Iterable[ShapeLike] | ShapeLike | None = None,
        segmentation: Segmentation | Mapping[str, Any] | None = None,
        **options: Any,
    ) -> None:
        given = {"shapes": shapes, "segmentation": segmentation}
        options |= {name: value for name, value in given.items() if value is not None}
        self.config = DetectorConfig.from_dict(options)
        self.shapes = self.config.resolved()
        self._without_rule = [spec.name for spec in self.shapes if spec.segmentation is None]
        functions = [*prepare(spec.segmentation for spec in self.shapes), *SHAPE_FUNCTIONS, *TRACK_FUNCTIONS]
        functions += (function for spec in self.shapes for function in spec.compiled_functions)
        compile_now(functions)
        if any(spec.lift == "cloud" for spec in self.shapes):
            import_module("shape_obs.point_cloud.deprojection")  # so that the first frame does not wait for it
        self.reset()

    def reset(self) -> None:
        """Forget the track: the next frame is a cold start."""
        self._tracks: dict[str, Track] = {}
        self._reach = Reach(self.config.max_speed)
        self._gone: set[str] = set()  # lost for longer than ``max_age``
        self._kinds: dict[str, tuple[type[Observed], tuple[int, int]]] = {}
        self._track_ids: dict[str, int] = {}  # of the last track of each shape
        self._last: dict[str, tuple[Shape, float]] = {}
        self._clock = Clock(self.config.dt)
        self._roi_memory: Any = None  # what a region of interest that moves remembers
        self._frames = 0

    def detect(
        self,
        rgb: npt.NDArray[np.uint8] | None,
        depth: npt.NDArray[Any] | None = None,
        camera: CameraModel | Intrinsics | None = None,
        *,
        stamp: float | None = None,
        anchors: Anchors = None,
    ) -> Detection:
        """Find the shapes in a frame.

        Args:
            rgb: ``(H, W, 3)`` uint8, RGB order; may be None for a segmentation by depth.
            depth: ``(H, W)`` uint16 millimetres or floating metres, aligned to rgb; 0, negative, NaN = invalid.
            camera: Intrinsics, or a camera model with its place in the base frame; with depth it gives 3D.
            stamp: In seconds; without stamps frames are ``dt`` apart.
            anchors: Name -> pixel (u, v) or base-frame point (x, y, z), for configurations with a named anchor.

        Raises:
            TypeError: An array of a wrong dtype.
            ValueError: A wrong shape, sizes that do not fit together, or an anchor that cannot be resolved.
            ShapeLostError: A shape was not found and ``on_missing="raise"``.
        """
        begin = time.perf_counter()
        frame = Frame(rgb, depth, camera if isinstance(camera, CameraModel) else as_camera_model(camera), stamp)
        if rgb is None and depth is None:
            raise ValueError("detect needs an rgb or a depth image, got neither.")
        for name in self._without_rule:
            raise ValueError(
                f"shape {name!r} has no segmentation: pass segmentation=HSVRange(low=..., high=...) to the detector, "
                "or a mask of your own to detect_mask."
            )
        return self._detect_in_image(frame, None, anchors, begin)

    def detect_mask(
        self,
        mask: npt.NDArray[Any],
        depth: npt.NDArray[Any] | None = None,
        camera: CameraModel | Intrinsics | None = None,
        *,
        stamp: float | None = None,
        anchors: Anchors = None,
    ) -> Detection:
        """Find the shapes in a mask from elsewhere: ``(H, W)`` bool or uint8, 0 = background. Else as ``detect``."""
        begin = time.perf_counter()
        frame = Frame(None, depth, as_camera_model(camera), stamp)
        return self._detect_in_image(frame, check_mask(mask, frame), anchors, begin)

    def detect_cloud(
        self,
        points: npt.NDArray[np.floating[Any]],
        *,
        camera: CameraModel | Intrinsics | None = None,
        stamp: float | None = None,
        anchors: Anchors = None,
    ) -> Detection:
        """Find the shapes in a cloud of one object's points; ``segmentation`` and ``roi`` are ignored.

        Shapes have ``points3d`` in the cloud's frame and no ``points2d``; a point is valid where the cloud has points
        near it. Without an anchor numbering goes by how the cloud looks along +z (x right, y down).

        Args:
            points: ``(M, 3)`` or ``(H, W, 3)`` floating metres; rows that are not finite, or all zero, are no points.
            camera: If given, the cloud is in the camera's frame, and anchors are in the base frame.
            stamp: In seconds; without stamps clouds are ``dt`` apart.
            anchors: Name -> point (x, y, z), in the cloud's frame without a camera.

        Raises:
            TypeError: An array of a wrong dtype.
            ValueError: A wrong shape, or an anchor that cannot be resolved.
            ShapeLostError: A shape was not found and ``on_missing="raise"``.
        """
        from shape_obs.point_cloud.cloud import read_cloud  # most detectors only see images

        begin = time.perf_counter()
        frame, cloud = Frame(None, None, as_camera_model(camera), stamp), read_cloud(points)
        now = _lap(timings := {}, "cloud", begin)
        self._clock.tick(frame.stamp)
        moment, shapes = _Moment(frame, timings, in_2d=False, in_3d=True), []
        for spec in self.shapes:
            found = self._fit(spec, cloud, anchors, moment, Scene())
            _lap(timings, "fit", now)
            shapes.append(self._finish(spec, found, moment))
            now = time.perf_counter()
        _lap(timings, "total", begin)
        return Detection(tuple(shapes), self._clock.stamp, timings, self._clock.warning)

    def _detect_in_image(
        self, frame: Frame, mask: npt.NDArray[np.uint8] | None, anchors: Anchors, begin: float
    ) -> Detection:
        """Find each shape in its mask, or in the cloud under it."""
        with_depth, timings = frame.depth is not None and frame.camera is not None, dict[str, float]()
        if not with_depth:
            for spec in self.shapes:
                spec.check_without_depth()
        roi, reason = self.config.roi, ""
        if type(roi).place is not ROI.place:
            now = time.perf_counter()
            roi, self._roi_memory, reason = roi.place(frame.rgb, self._roi_memory)
            _lap(timings, "roi", now)
        self._frames += 1
        tracks = self._tracks if self._frames % _SEARCH_ALL else {}
        search = None if roi is None else RegionSearch(frame, mask, roi, self.shapes, tracks)
        self._clock.tick(frame.stamp)
        size = (frame.size or (0, 0)) if mask is None else (mask.shape[0], mask.shape[1])
        moment, shapes = _Moment(frame, timings, in_2d=True, in_3d=with_depth, size=size), []
        for spec in self.shapes:
            found = Fit(reason=reason) if search is None else self._find(spec, search, anchors, moment)
            shapes.append(self._finish(spec, found, moment))
        _lap(timings, "total", begin)
        return Detection(tuple(shapes), self._clock.stamp, timings, self._clock.warning)

    def _find(self, spec: Configuration, search: RegionSearch, anchors: Anchors, moment: _Moment) -> Fit:
        """Find one shape in an image: near where the track expects it, and if that fails everywhere."""
        frame, camera = moment.frame, moment.frame.camera if moment.in_3d else None
        diagonal = math.hypot(*moment.size)
        scene = Scene(search.whole, diagonal=diagonal)
        if camera is not None:
            scene = Scene(search.whole, frame.depth, camera.intrinsics, frame.images, diagonal)
        while True:
            now, timings = time.perf_counter(), moment.timings
            observed: Observed = search.region(spec.segmentation)  # image -> region
            now = _lap(timings, "segmentation" if search.mask is None else "region", now)
            if spec.lift == "cloud":
                observed = search.cloud(spec.segmentation)  # depth enters: region -> cloud
                now = _lap(timings, "cloud", now)
            found = self._fit(spec, observed, anchors, moment, scene)  # -> form, matched and validated
            _lap(timings, "fit", now)
            if not found.reason or found.follow or not search.widen(spec.segmentation):
                return found

    def _fit(self, spec: Configuration, observed: Observed, anchors: Anchors, moment: _Moment, scene: Scene) -> Fit:
        """Fit a configuration to an object, from its track if there is one, and advance the track."""
        kind = type(observed), moment.size
        if self._kinds.setdefault(spec.name, kind) != kind:
            self._tracks.pop(spec.name, None)  # pixels cannot be compared with metres, or those of another size
            self._last.pop(spec.name, None)
            self._kinds[spec.name] = kind
        track, gone, target = self._tracks.get(spec.name), spec.name in self._gone, None
        if spec.anchor is not None and (track is None or gone or spec.order == "image"):
            target = (anchor_pixel if moment.in_2d else anchor_point)(spec, anchors, moment.frame.camera)
        if observed.refusal:
            return Fit(reason=observed.refusal)
        prediction = predict(track, observed, self._clock.now, gone)
        found = spec.fit(observed, prediction, target, scene)
        if track is not None and prediction is not None and (not found.reason or found.follow):
            view = scene.images, 0.0 if scene.intrinsics is None else scene.intrinsics.fx
            if far := self._reach.exceeded(spec.name, track, found, self._clock.now, view, moment.size[1]):
                found = spec.fit(observed, None, target, scene) if prediction.stale else Fit(reason=far)
        if not found.reason or found.follow:
            track = None if found.new or gone else track
            self._gone.discard(spec.name)
            number = self._track_ids.get(spec.name, 0) + 1 if track is None else track.track_id
            found, self._track_ids[spec.name] = found._replace(track_id=number), number
            self._tracks[spec.name] = advance(track, found, observed, self._clock.now)
        if not found.reason:
            if spec.order == "image":
                seen = observed.seen(found.form.points, target)
                found = found._replace(form=spec.apply_index_order(found.form, seen, target), laid=None)
            if isinstance(self.config.clustering, Clusterer):
                from shape_obs.configurations.cluster_assignment import assign_centres  # the map needs none

                found = assign_centres(found, observed, spec, self.config.clustering)
        return found

    def _finish(self, spec: Configuration, found: Fit, moment: _Moment) -> Shape:
        """Turn a form into ordered points, in space if there is depth; or apply the policy for a lost shape."""
        now, clock = time.perf_counter(), self._clock
        last, seen_at = self._last.get(spec.name, (None, 0.0))
        shape, reason = None, found.reason
        if not found.reason:  # depth enters: -> points
            shape = shape_of(spec, found, moment.frame, last, self.config.on_invalid, math.hypot(*moment.size))
            shape, reason = (None, shape.reason) if shape.reason else (shape, "")
        if shape is not None:
            self._last[spec.name] = (shape, clock.now)
        else:
            age = clock.now - seen_at
            if last is not None and age > self.config.max_age and found.reason:  # else it is still tracked
                self._gone.add(spec.name)
                if not spec.resumes:
                    self._tracks.pop(spec.name, None)
            reason = f"{reason}; {clock.warning}" if clock.warning else reason
            shape = lost_shape(
                spec.name, spec.layout, reason=reason, in_2d=moment.in_2d, in_3d=moment.in_3d, last=last, age=age,
                max_age=self.config.max_age, policy=self.config.on_missing, diagonal=math.hypot(*moment.size),
            )  # fmt: skip
        _lap(moment.timings, "lift", now)
        return shape


def _lap(timings: dict[str, float], stage: str, since: float) -> float:
    """Add the milliseconds since a time to a stage; return the time now."""
    now = time.perf_counter()
    timings[stage] = timings.get(stage, 0.0) + 1e3 * (now - since)
    return now
