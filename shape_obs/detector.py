"""ShapeDetector: the pipeline from a frame to shapes, and its memory. Nothing else."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraModel, Intrinsics, as_camera_model
from shape_obs.clustering import Clusterer
from shape_obs.compiled import Kernels, choose
from shape_obs.compiled.warmup import warm_up
from shape_obs.config import DetectorConfig
from shape_obs.configurations import Configuration
from shape_obs.configurations.anchors import Anchors, anchor_pixel, anchor_point
from shape_obs.configurations.cluster_assignment import clustered
from shape_obs.configurations.fitting import Fit, fit
from shape_obs.configurations.points import shape_of
from shape_obs.frame import Frame, check_mask
from shape_obs.image.region import prepare
from shape_obs.image.segmentation import Segmentation
from shape_obs.point_cloud.body import Body
from shape_obs.point_cloud.cloud import Cloud, read_cloud
from shape_obs.point_cloud.deprojection import SeenCloud
from shape_obs.shape import Detection, Shape
from shape_obs.tracking.missing import lost_shape
from shape_obs.tracking.prediction import Expected, Track
from shape_obs.tracking.search_window import View, outlooks, placed
from shape_obs.utils.threads import use_no_threads_in_forked_children
from shape_obs.utils.timing import Timed

Array = npt.NDArray[np.float64]

# Frames after which all of the image is looked at, though every shape is tracked: what was hidden may be back.
_LOOK_AROUND: Final = 30

use_no_threads_in_forked_children()


class ShapeDetector:
    """Finds shapes in frames and keeps the index of their points from one frame to the next.

    Args:
        shapes: Configurations, as specs, mappings or names: ``[Centerline(n=20)]``, ``["centerline"]``.
        segmentation: The pixel rule, as a spec or a mapping; not needed for ``detect_mask``.
        options: The other fields of ``DetectorConfig``.

    Attributes:
        config: What was given.
        shapes: The configurations, the detector's defaults filled in.

    Raises:
        SpecError: An argument that is not understood; the nearest known name is told.

    Example:
        >>> detector = ShapeDetector([Centerline(n=20)], HSVRange(low=(90, 60, 30), high=(130, 255, 255)))
        >>> shape = detector.detect(rgb, depth, intrinsics).shapes[0]  # doctest: +SKIP
        >>> shape.points3d.shape  # doctest: +SKIP
        (20, 3)
    """

    def __init__(
        self,
        shapes: Iterable[Configuration | Mapping[str, Any] | str]
        | Configuration
        | Mapping[str, Any]
        | str
        | None = None,
        segmentation: Segmentation | Mapping[str, Any] | None = None,
        **options: Any,
    ) -> None:
        given: dict[str, Any] = dict(options)
        if shapes is not None:
            given["shapes"] = shapes
        if segmentation is not None:
            given["segmentation"] = segmentation
        self.config = DetectorConfig.from_dict(given)
        self.shapes = self.config.resolved()
        for rule in {spec.segmentation for spec in self.shapes}:
            prepare(rule, self.kernels)
        if self.kernels.compiled:
            warm_up(ShapeDetector, self.shapes, self.config.backend)
        self.reset()

    @property
    def kernels(self) -> Kernels:
        """What runs the inner loops. Modules are not pickled: the backend is known by its name."""
        return choose(self.config.backend)

    def reset(self) -> None:
        """Forget the track: the next frame is a cold start."""
        self._tracks: dict[str, Track] = {}
        self._kinds: dict[str, type[Body]] = {}
        self._last: dict[str, tuple[Shape, float]] = {}
        self._stamp: float | None = None
        self._place: Any = None  # what a region of interest that moves remembers
        self._looked = 0
        self._begin = 0.0

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
            rgb: (H,W,3) uint8, RGB order; may be None for a segmentation by depth.
            depth: (H,W) uint16 millimetres or floating metres, aligned to rgb; 0, negative or non-finite = invalid.
            camera: Intrinsics, or a camera model that knows its place in the base frame; with depth it gives 3D.
            stamp: Seconds; without stamps frames are ``dt`` apart.
            anchors: Name -> pixel (u, v) or base-frame point (x, y, z), for configurations with a named anchor.

        Raises:
            TypeError: An array of a wrong dtype.
            ValueError: A wrong shape, sizes that do not fit together, or an anchor that cannot be resolved.
            ShapeLostError: A shape was not found and ``on_missing="raise"``.
        """
        begin = time.perf_counter()
        frame = Frame(rgb, depth, as_camera_model(camera), stamp)
        if frame.size is None:
            raise ValueError("detect needs an rgb or a depth image, got neither.")
        for spec in self.shapes:
            if spec.segmentation is None:
                raise ValueError(
                    f"shape {spec.name!r} has no segmentation: pass segmentation=HSVRange(low=..., high=...) to the "
                    "detector, or a mask of your own to detect_mask."
                )
        return self._on_image(frame, None, anchors, begin)

    def detect_mask(
        self,
        mask: npt.NDArray[Any],
        depth: npt.NDArray[Any] | None = None,
        camera: CameraModel | Intrinsics | None = None,
        *,
        stamp: float | None = None,
        anchors: Anchors = None,
    ) -> Detection:
        """Find the shapes in a mask that someone else made: (H,W) bool or uint8, 0 = background. Else as ``detect``."""
        begin = time.perf_counter()
        frame = Frame(None, depth, as_camera_model(camera), stamp)
        mask = check_mask(mask)
        size = (mask.shape[0], mask.shape[1])
        for name, other in (
            ("depth", frame.size),
            ("the camera's intrinsics", frame.camera and frame.camera.intrinsics.size),
        ):
            if other is not None and other != size:
                raise ValueError(
                    f"the mask has {size[1]} x {size[0]} pixels, {name} {other[1]} x {other[0]}: they must be equal."
                )
        return self._on_image(frame, mask, anchors, begin)

    def detect_cloud(
        self,
        points: npt.NDArray[np.floating[Any]],
        *,
        camera: CameraModel | Intrinsics | None = None,
        stamp: float | None = None,
        anchors: Anchors = None,
    ) -> Detection:
        """Find the shapes in a cloud of one object's points; segmentation and ROI have no say.

        Shapes have ``points3d`` in the cloud's frame and no ``points2d``; a point is visible and valid where the cloud
        has points near it. Without an anchor numbering goes by how the cloud looks along +z (x right, y down).

        Args:
            points: (M,3) or (H,W,3) floating metres; rows that are not finite, or all zero, are no points.
            camera: Says that the cloud is in the camera's frame, and anchors in the base frame.
            stamp: Seconds; without stamps clouds are ``dt`` apart.
            anchors: Name -> point (x, y, z), for configurations with a named anchor; in the cloud's frame without a
                camera.

        Raises:
            TypeError: An array of a wrong dtype.
            ValueError: A wrong shape, or an anchor that cannot be resolved.
            ShapeLostError: A shape was not found and ``on_missing="raise"``.
        """
        begin = time.perf_counter()
        frame = Frame(None, None, as_camera_model(camera), stamp)
        timings: dict[str, float] = {}
        with Timed(timings, "cloud"):
            cloud = read_cloud(points, self.kernels)
        targets = [anchor_point(spec, anchors, frame.camera) for spec in self.shapes]
        stamp = self._next_stamp(frame)
        shapes = [
            self._shape(spec, frame, cloud, *self._fit(spec, cloud, target, stamp, timings), stamp, timings)
            for spec, target in zip(self.shapes, targets, strict=True)
        ]
        timings["total"] = 1e3 * (time.perf_counter() - begin)
        return Detection(tuple(shapes), stamp, timings)

    def _on_image(self, frame: Frame, mask: npt.NDArray[np.uint8] | None, anchors: Anchors, begin: float) -> Detection:
        """Find each shape in its mask, or in the cloud under it: where it is expected, else everywhere."""
        for spec in self.shapes:
            asked = "lift='cloud'" if spec.lift == "cloud" else "spacing='m'" if spec.spacing == "m" else ""
            if asked and (frame.depth is None or frame.camera is None):
                instead = "lift='points'" if spec.lift == "cloud" else "spacing='px'"
                raise ValueError(f"shape {spec.name!r}: {asked} needs depth and a camera; give both, or {instead}.")
        targets = [anchor_pixel(spec, anchors, frame.camera) for spec in self.shapes]
        timings: dict[str, float] = {}
        region, self._place, reason = placed(self.config.roi, frame, self._place, timings)
        view = None if region is None else View(frame, mask, region, self.kernels, timings)
        stamp = self._next_stamp(frame)
        expected = self._expected()
        shapes = []
        for spec, target in zip(self.shapes, targets, strict=True):
            if view is None:
                shapes.append(self._shape(spec, frame, None, Fit(None, reason=reason), None, stamp, timings))
                continue
            body = view.body(spec, expected.get(spec.segmentation))
            found, present = self._fit(spec, body, target, stamp, timings, frame.depth)
            if not found.ok and view.look_everywhere(spec):
                body = view.body(spec, None)
                found, present = self._fit(spec, body, target, stamp, timings, frame.depth)
            shapes.append(self._shape(spec, frame, body, found, present, stamp, timings))
        timings["total"] = 1e3 * (time.perf_counter() - begin)
        return Detection(tuple(shapes), stamp, timings)

    def _expected(self) -> dict[Segmentation | None, Expected | None]:
        """Where the shapes of each segmentation will all be; once in a while nothing is expected anywhere."""
        self._looked += 1
        return {} if self._looked % _LOOK_AROUND == 0 else outlooks(self.shapes, self._tracks)

    def _fit(
        self, spec: Configuration, body: Body, target: Array | None, stamp: float, timings: Any, depth: Any = None
    ) -> tuple[Fit, Track | None]:
        if self._kinds.setdefault(spec.name, type(body)) is not type(body):
            self._tracks.pop(spec.name, None)  # pixels say nothing about metres
            self._last.pop(spec.name, None)
            self._kinds[spec.name] = type(body)
        with Timed(timings, "fit"):
            return fit(body, spec, self._tracks.get(spec.name), target, stamp, depth)

    def _shape(
        self,
        spec: Configuration,
        frame: Frame,
        body: Body | None,
        found: Fit,
        present: Track | None,
        stamp: float,
        timings: dict[str, float],
    ) -> Shape:
        """The shape of a fit, and what is remembered of it."""
        if body is not None and isinstance(self.config.clustering, Clusterer):
            with Timed(timings, "clustering"):
                found = clustered(found, body, spec, self.config.clustering)
        with Timed(timings, "lift"):
            shape = self._finish(spec, found, body, frame, stamp)
        if present is not None:
            self._tracks[spec.name] = present
        if not shape.reason:
            self._last[spec.name] = (shape, stamp)
        elif stamp - self._last.get(spec.name, (shape, stamp))[1] > self.config.max_age:
            self._tracks.pop(spec.name, None)
        return shape

    def _next_stamp(self, frame: Frame) -> float:
        following = 0.0 if self._stamp is None else self._stamp + self.config.dt
        stamp = following if frame.stamp is None else float(frame.stamp)
        if self._stamp is None:
            self._begin = stamp
        elif stamp < self._stamp:  # another clock: no time has passed, and ages go on from what they were
            back = self._stamp - stamp
            self._begin -= back
            self._last = {name: (shape, at - back) for name, (shape, at) in self._last.items()}
        self._stamp = stamp
        return stamp

    def _finish(self, spec: Configuration, found: Fit, body: Body | None, frame: Frame, stamp: float) -> Shape:
        """From a form to ordered points, in space where there is depth; or what stands in for them."""
        in_3d = isinstance(body, Cloud) or (frame.depth is not None and frame.camera is not None)
        last, seen = self._last.get(spec.name, (None, self._begin))
        reason = found.reason
        if body is not None and found.form is not None and found.ok:
            shape = shape_of(spec, found, found.form, found.body or body, frame, last, self.config.on_invalid)
            seen_whole = shape.points2d is None or np.isfinite(shape.points2d).all()
            if seen_whole and (not in_3d or np.count_nonzero(shape.valid)):
                return shape
            reason = "no point has depth under it" if seen_whole else "it runs out of the camera's sight"
        return lost_shape(
            spec.name,
            spec.layout,
            reason=reason,
            in_2d=not isinstance(body, Cloud) or isinstance(body, SeenCloud),
            in_3d=in_3d,
            last=last,
            age=max(stamp - seen, 0.0),
            max_age=self.config.max_age,
            policy=self.config.on_missing,
        )
