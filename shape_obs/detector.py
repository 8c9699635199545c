"""ShapeDetector: the pipeline from a frame to shapes, and its memory. Nothing else."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraModel, Intrinsics, as_camera_model
from shape_obs.config import DetectorConfig
from shape_obs.configurations import Configuration
from shape_obs.fitting import Fit, fit
from shape_obs.forking import use_no_threads_in_forked_children
from shape_obs.frame import Frame, check_mask
from shape_obs.lift import lift, lift_curve, local_depth
from shape_obs.missing import fill_invalid, lost_shape
from shape_obs.region import Region, find_region
from shape_obs.segmentation import Segmentation
from shape_obs.shape import Detection, Shape
from shape_obs.spec import did_you_mean
from shape_obs.tracking import Track

Array = npt.NDArray[np.float64]

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
        self.reset()

    def reset(self) -> None:
        """Forget the track: the next frame is a cold start."""
        self._tracks: dict[str, Track] = {}
        self._last: dict[str, tuple[Shape, float]] = {}
        self._stamp: float | None = None
        self._begin = 0.0

    def detect(
        self,
        rgb: npt.NDArray[np.uint8] | None,
        depth: npt.NDArray[Any] | None = None,
        camera: CameraModel | Intrinsics | None = None,
        *,
        stamp: float | None = None,
        anchors: Mapping[str, Sequence[float]] | None = None,
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
        timings: dict[str, float] = {}
        regions: dict[Segmentation | None, Region] = {}
        window = self.config.roi.window(frame.size)
        for rule in dict.fromkeys(spec.segmentation for spec in self.shapes):
            assert rule is not None
            with _Timed(timings, "segmentation"):
                mask = self.config.roi.blank(rule.apply(frame, window), window)
            with _Timed(timings, "region"):
                regions[rule] = find_region(mask, window, rule.min_area, rule.min_share)
        return self._shapes(frame, regions, anchors, timings, begin)

    def detect_mask(
        self,
        mask: npt.NDArray[Any],
        depth: npt.NDArray[Any] | None = None,
        camera: CameraModel | Intrinsics | None = None,
        *,
        stamp: float | None = None,
        anchors: Mapping[str, Sequence[float]] | None = None,
    ) -> Detection:
        """Find the shapes in a mask that someone else made: (H,W) bool or uint8, 0 = background. Else as ``detect``."""
        begin = time.perf_counter()
        frame = Frame(None, depth, as_camera_model(camera), stamp)
        mask = check_mask(mask)
        size = (mask.shape[0], mask.shape[1])
        for name, other in (("depth", frame.size), ("the camera's intrinsics", _size(frame.camera))):
            if other is not None and other != size:
                raise ValueError(
                    f"the mask has {size[1]} x {size[0]} pixels, {name} {other[1]} x {other[0]}: they must be equal."
                )
        timings: dict[str, float] = {}
        regions: dict[Segmentation | None, Region] = {}
        window = self.config.roi.window(size)
        for rule in dict.fromkeys(spec.segmentation for spec in self.shapes):
            floor = rule or Segmentation
            with _Timed(timings, "region"):
                cut = self.config.roi.blank(mask[window.slices], window)
                regions[rule] = find_region(cut, window, floor.min_area, floor.min_share)
        return self._shapes(frame, regions, anchors, timings, begin)

    def _shapes(
        self,
        frame: Frame,
        regions: Mapping[Segmentation | None, Region],
        anchors: Mapping[str, Sequence[float]] | None,
        timings: dict[str, float],
        begin: float,
    ) -> Detection:
        stamp = self._next_stamp(frame)
        shapes = []
        for spec in self.shapes:
            region = regions[spec.segmentation]
            track = self._tracks.get(spec.name)
            with _Timed(timings, "fit"):
                found, present = fit(region, spec, track, _anchor_pixel(spec, anchors, frame.camera), stamp)
            with _Timed(timings, "lift"):
                shape = self._finish(spec, found, region, frame, stamp)
            if present is not None:
                self._tracks[spec.name] = present
            if not shape.reason:
                self._last[spec.name] = (shape, stamp)
            elif stamp - self._last.get(spec.name, (shape, stamp))[1] > self.config.max_age:
                self._tracks.pop(spec.name, None)
            shapes.append(shape)
        timings["total"] = 1e3 * (time.perf_counter() - begin)
        return Detection(tuple(shapes), stamp, timings)

    def _next_stamp(self, frame: Frame) -> float:
        following = 0.0 if self._stamp is None else self._stamp + self.config.dt
        stamp = following if frame.stamp is None else float(frame.stamp)
        if self._stamp is None:
            self._begin = stamp
        self._stamp = stamp
        return stamp

    def _finish(self, spec: Configuration, found: Fit, region: Region, frame: Frame, stamp: float) -> Shape:
        """From a curve to ordered points, lifted where there is depth; or what stands in for them."""
        in_3d = frame.depth is not None and frame.camera is not None
        if spec.spacing == "m" and not in_3d:
            raise ValueError(f"shape {spec.name!r}: spacing='m' needs depth and a camera; give both, or spacing='px'.")
        reason = found.reason
        if found.form is not None and found.ok:
            shape = self._points(spec, found, region, frame)
            if not in_3d or shape.valid.any():
                return shape
            reason = "no point has depth under it"
        last, seen = self._last.get(spec.name, (None, self._begin))
        return lost_shape(
            spec.name,
            spec.layout,
            reason=reason,
            in_2d=True,
            in_3d=in_3d,
            last=last,
            age=stamp - seen,
            max_age=self.config.max_age,
            policy=self.config.on_missing,
        )

    def _points(self, spec: Configuration, found: Fit, region: Region, frame: Frame) -> Shape:
        assert found.form is not None
        metric = form = found.form
        camera = frame.camera
        if spec.spacing == "m" and frame.depth is not None and camera is not None:
            lifted = lift_curve(form.points, frame.depth, region, region.width, camera.intrinsics)
            metric = form if lifted is None else form.measured(lifted)
        points, bridged = spec.place(form, metric)
        visible = region.carries(points) & ~bridged
        valid, points3d = visible, None
        if frame.depth is not None and camera is not None:
            z = local_depth(points, frame.depth, region, region.width)
            z[~visible] = np.nan
            points3d = lift(points, z, camera.intrinsics, spec.radius).astype(np.float32)
            valid = visible & np.isfinite(z)
            last = self._last.get(spec.name)
            before = None if last is None else last[0].points3d
            points3d = fill_invalid(points3d, before, self.config.on_invalid, spec.layout)
        quality = found.quality * float(valid.mean())
        return Shape(
            spec.name, points.astype(np.float32), points3d, visible, valid.copy(), spec.layout, quality=quality
        )


class _Timed:
    """Adds the time spent in its block to a stage, in milliseconds."""

    def __init__(self, timings: dict[str, float], stage: str) -> None:
        self._timings, self._stage = timings, stage

    def __enter__(self) -> None:
        self._begin = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        spent = 1e3 * (time.perf_counter() - self._begin)
        self._timings[self._stage] = self._timings.get(self._stage, 0.0) + spent


def _size(camera: CameraModel | None) -> tuple[int, int] | None:
    return None if camera is None else (camera.intrinsics.height, camera.intrinsics.width)


def _anchor_pixel(
    spec: Configuration, anchors: Mapping[str, Sequence[float]] | None, camera: CameraModel | None
) -> Array | None:
    """The pixel of a configuration's anchor."""
    anchor: Any = spec.anchor
    if isinstance(anchor, str):
        known = anchors or {}
        if anchor not in known:
            raise ValueError(f"shape {spec.name!r}: anchor {anchor!r} was not given{did_you_mean(anchor, known)}")
        anchor = known[anchor]
    if anchor is None:
        return None
    point = np.asarray(anchor, dtype=np.float64)
    if point.shape not in ((2,), (3,)) or not np.all(np.isfinite(point)):
        raise ValueError(f"shape {spec.name!r}: anchor must be a finite (u, v) or (x, y, z), got {anchor!r}.")
    if len(point) == 2:
        return point
    if camera is None or camera.transform_camera_to_base is None:
        raise ValueError(
            f"shape {spec.name!r}: anchor {anchor!r} in the base frame needs the camera's place there: give "
            "camera=CameraModel(intrinsics, transform_camera_to_base=T), or an anchor in pixels (u, v)."
        )
    pixel = camera.project_from_base(point)
    if not np.all(np.isfinite(pixel)):
        raise ValueError(f"shape {spec.name!r}: anchor {anchor!r} does not lie in front of the camera.")
    return pixel
