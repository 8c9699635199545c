"""ShapeDetector: the way of a frame, from images to ordered points.

image -> region -> initial form or prediction -> self-organising map -> matched to the track -> validated -> lifted.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraLike, as_camera_model
from shape_obs.clustering.base import Clusterer
from shape_obs.compiled import compile_now
from shape_obs.config.detector_config import DetectorConfig
from shape_obs.configurations.base import Configuration
from shape_obs.configurations.shape_points import SHAPE_FUNCTIONS
from shape_obs.frame import Frame, depth_images
from shape_obs.geometry.crossings import Crossing
from shape_obs.geometry.intersections import crossings_of
from shape_obs.geometry.observed import Observed
from shape_obs.geometry.polyline import nearest_along
from shape_obs.image.find_region import prepare
from shape_obs.image.mask_check import check_given_mask
from shape_obs.image.mask_hints import MaskHints, UnitCheck
from shape_obs.image.over_under import find_layers
from shape_obs.image.region import Region
from shape_obs.image.roi import ROI
from shape_obs.image.segmentation import Segmentation
from shape_obs.shape import Detection, Shape
from shape_obs.slots import SLOT_FUNCTIONS, Slots
from shape_obs.tracker import Tracker
from shape_obs.tracking.clock import Clock
from shape_obs.tracking.predict import Fit, Track
from shape_obs.tracking.scene import Anchors, Scene
from shape_obs.tracking.search_window import RegionSearch
from shape_obs.tracking.speed_gate import TRACK_FUNCTIONS
from shape_obs.utils.threads import use_no_threads_in_forked_children

Array = npt.NDArray[np.float64]
ShapeLike = Configuration | Mapping[str, Any] | str
SegmentationLike = Segmentation | Mapping[str, Any] | str | Callable[..., Any]

_SEARCH_ALL: Final = 30  # frames, after which all of the image is searched: what was hidden may be back

use_no_threads_in_forked_children()


class ShapeDetector:
    """Find shapes in frames and keep the index of their points from one frame to the next.

    Args:
        shapes: Configurations, as specs, mappings or names: ``[Centerline(n=20)]``, ``["centerline"]``.
        segmentation: The pixel rule, as a spec, a mapping, a function ``(rgb, depth) -> mask`` or its import path
            ``"module:function"``, see ``MaskFunction``; not needed for ``detect_mask``.
        options: The other fields of ``DetectorConfig``.

    Attributes:
        config: The arguments, as one spec.
        shapes: The configurations, the detector's defaults filled in.

    Raises:
        SpecError: An argument is not understood; the message names the nearest valid one.

    Example:
        >>> blue = HSVRange(low=(90, 60, 30), high=(130, 255, 255))
        >>> detector = ShapeDetector([Centerline(n=20)], blue)
        >>> shape = detector.detect(rgb, depth, intrinsics).shapes[0]  # doctest: +SKIP
        >>> shape.points3d.shape  # doctest: +SKIP
        (20, 3)
    """

    config: DetectorConfig
    shapes: tuple[Configuration, ...]

    def __init__(
        self,
        shapes: Iterable[ShapeLike] | ShapeLike | None = None,
        segmentation: SegmentationLike | None = None,
        **options: Any,
    ) -> None:
        given = {"shapes": shapes, "segmentation": segmentation}
        options |= {name: value for name, value in given.items() if value is not None}
        self.config = DetectorConfig.from_dict(options)
        self._filled, self.shapes = self.config.filled(), self.config.resolved()
        self._without_rule = [spec.name for spec in self.shapes if spec.segmentation is None]
        functions = [*prepare(spec.segmentation for spec in self.shapes), *SHAPE_FUNCTIONS, *TRACK_FUNCTIONS]
        functions += (function for spec in self.shapes for function in spec.compiled_functions)
        if any(spec.count is not None for spec in self.config.shapes):
            functions += SLOT_FUNCTIONS
        if isinstance(self.config.clustering, Clusterer):
            functions.append(nearest_along)  # the centres are put in order along the form
        compile_now(functions)
        if any(spec.lift == "cloud" for spec in self.shapes):
            import_module("shape_obs.point_cloud.deprojection")  # so that the first frame does not wait for it
        self._units, self._clock = UnitCheck(), Clock(self.config.dt)
        self._hints = MaskHints(spec.segmentation for spec in self.shapes)
        self.reset()

    def reset(self) -> None:
        """Forget the tracks: the next frame is a cold start."""
        self._followed: list[Tracker | Slots] = [
            Tracker(spec, self.config) if spec.count is None else Slots(spec, self.config) for spec in self._filled
        ]
        self._trackers = [tracker for followed in self._followed for tracker in followed.trackers]
        self._units.reset()
        self._clock.reset()
        self._hints = MaskHints(self._hints.reds)
        self._roi_memory: Any = None  # what a region of interest that moves remembers
        self._frames = 0

    def detect(
        self,
        rgb: npt.NDArray[np.uint8] | None,
        depth: npt.NDArray[Any] | None = None,
        camera: CameraLike = None,
        *,
        stamp: float | None = None,
        anchors: Anchors = None,
    ) -> Detection:
        """Find the shapes in a frame.

        Args:
            rgb: ``(H, W, 3)`` uint8, RGB order; may be None for a segmentation by depth.
            depth: ``(H, W)`` uint16 millimetres or floating metres, aligned to rgb; 0, negative, NaN = invalid.
            camera: Intrinsics, or a camera model with its place in the base frame; with depth it gives 3D. The forms of
                librealsense, ROS and OpenCV are read too, see ``as_camera_model``.
            stamp: In seconds; without stamps frames are ``dt`` apart.
            anchors: Name -> pixel (u, v) or base-frame point (x, y, z), for configurations with a named anchor.

        Raises:
            TypeError: An array of a wrong dtype, or what is no camera.
            ValueError: A wrong shape, sizes that do not fit together, or an anchor that cannot be resolved.
            ShapeLostError: A shape was not found and ``on_missing="raise"``.
        """
        begin = time.perf_counter()
        frame = Frame(rgb, depth, camera, stamp)
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
        camera: CameraLike = None,
        *,
        rgb: npt.NDArray[np.uint8] | None = None,
        stamp: float | None = None,
        anchors: Anchors = None,
    ) -> Detection:
        """Find the shapes in a mask from elsewhere: ``(H, W)`` bool, or 0 and 1, or 0 and 255. Else as ``detect``.

        The picture ``rgb``, if there is one, shows which strand is above at a crossing, and with a ``count`` which
        ropes have unlike colours.
        """
        begin = time.perf_counter()
        frame = Frame(rgb, depth, as_camera_model(camera, np.shape(mask)[:2]), stamp)
        return self._detect_in_image(frame, check_given_mask(mask, frame), anchors, begin)

    def detect_cloud(
        self,
        points: npt.NDArray[np.floating[Any]],
        *,
        camera: CameraLike = None,
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
        frame, cloud = Frame(None, None, camera, stamp), read_cloud(points)
        if self._units.pending:
            self._units.look_at_cloud(cloud.points)
        laps = [("", begin), ("cloud", time.perf_counter())]
        self._clock.tick(frame.stamp)
        intrinsics, shapes = None if frame.camera is None else frame.camera.intrinsics, []
        scene = Scene(frame, self._clock, anchors, in_2d=False, in_3d=True, intrinsics=intrinsics)
        for tracker in self._followed:
            if isinstance(tracker, Slots):
                raise ValueError(f"shape {tracker.spec.name!r}: a cloud is of one object; count= needs an image.")
            found = tracker.fit(cloud, scene)
            laps.append(("fit", time.perf_counter()))
            shapes.append(tracker.finish(found, scene))
            laps.append(("lift", time.perf_counter()))
        return Detection(tuple(shapes), self._clock.stamp, _timings(laps), self._clock.warning)

    def _detect_in_image(
        self, frame: Frame, mask: npt.NDArray[np.uint8] | None, anchors: Anchors, begin: float
    ) -> Detection:
        """Find each shape in its mask, or in the cloud under it."""
        if frame.depth is None or frame.camera is None:
            for spec in self.shapes:
                spec.check_without_depth()
        roi, reason, laps = self.config.roi, "", [("", begin)]
        if type(roi).place is not ROI.place:
            laps.append(("", time.perf_counter()))
            roi, self._roi_memory, reason = roi.place(frame.rgb, self._roi_memory)
            laps.append(("roi", time.perf_counter()))
        self._frames += 1
        size = (frame.size or (0, 0)) if mask is None else (mask.shape[0], mask.shape[1])
        edge = search = None
        if roi is not None:
            edge = roi.window(size)
            tracks: dict[Segmentation | None, list[Track | None]] = {}
            for each in self._trackers:
                tracks.setdefault(each.spec.segmentation, []).append(each.track)
            search = RegionSearch(frame, mask, roi, edge, tracks, self._frames % _SEARCH_ALL == 0)
        self._clock.tick(frame.stamp)
        scene = Scene.in_image(frame, self._clock, size, edge, anchors)
        shapes, more = [], {}
        laps.append(("", time.perf_counter()))
        for followed in self._followed:
            if search is None:
                shapes += [tracker.finish(Fit(reason=reason), scene) for tracker in followed.trackers]
            else:
                shapes += self._find(followed, search, scene, laps)
            if isinstance(followed, Slots) and followed.more:
                more[followed.spec.name] = followed.more
        if self._units.pending and frame.depth is not None and search is not None:
            self._units.look_at_depth(search.regions.values(), frame.depth)
        shapes, crossings = self._cross(shapes, frame)
        laps.append(("", time.perf_counter()))
        return Detection(tuple(shapes), self._clock.stamp, _timings(laps), self._clock.warning, more, crossings)

    def _cross(self, shapes: list[Shape], frame: Frame) -> tuple[list[Shape], tuple[Crossing, ...]]:
        """Find where ropes cross, and which one is above; return the shapes with their crossings, and all of them."""
        ropes: dict[str, Tracker] = {}
        curves, widths = [], []
        for each in self._trackers:
            if each.strand is not None:
                ropes[each.spec.name] = each
                curves.append(each.strand[0])
                widths.append(each.strand[1])
        names = list(ropes)
        crossings = crossings_of(curves, names) if curves else ()
        if crossings:
            crossings = find_layers(crossings, curves, names, widths, depth_images(frame.depth), frame.rgb)
            for k, shape in enumerate(shapes):
                if own := tuple(each for each in crossings if shape.name in each.slots):
                    shapes[k] = ropes[shape.name].cross(shape, own)
        return shapes, crossings

    def _explained(self, region: Region, followed: Tracker | Slots, search: RegionSearch) -> Region:
        """Return an empty region with hints in its refusal, if the shape was never found and a rule looked for it."""
        rule = followed.spec.segmentation
        if search.mask is not None or rule is None or region.noise or any(each.was_found for each in followed.trackers):
            return region
        mask = search.whole_mask(rule) if rule.whole_image else None
        return self._hints.explained(region, rule, search.frame, mask, search.roi, self._frames)

    def _find(
        self, followed: Tracker | Slots, search: RegionSearch, scene: Scene, laps: list[tuple[str, float]]
    ) -> list[Shape]:
        """Find a shape, or several in one mask: near where the tracks expect them, and if that fails everywhere."""
        rule, lift = followed.spec.segmentation, followed.spec.lift
        while True:
            region = search.region(rule)  # image -> region
            if region.refusal:
                region = self._explained(region, followed, search)
            elif search.mask is None and self._hints.reds:
                self._hints.look_at_red(rule, scene.frame)
            laps.append(("segmentation" if search.mask is None else "region", time.perf_counter()))
            if isinstance(followed, Slots):
                tries = followed.attempt(region, scene)
                laps.append(("fit", time.perf_counter()))
                if all(each is not None and each.is_found for each in tries) or not search.widen(rule):
                    shapes = followed.accept(tries, scene)
                    break
                continue
            observed: Observed = region
            if lift == "cloud" and not (region.refusal and not followed.was_found):
                observed = search.cloud(rule)  # depth enters: region -> cloud
                laps.append(("cloud", time.perf_counter()))
            found = followed.fit(observed, scene)  # -> form, matched and validated
            laps.append(("fit", time.perf_counter()))
            if not found.reason or found.follow or not search.widen(rule):
                shapes = [followed.finish(found, scene)]
                break
        laps.append(("lift", time.perf_counter()))
        return shapes


def _timings(laps: list[tuple[str, float]]) -> dict[str, float]:
    """Return the milliseconds of each stage, and of all together.

    Args:
        laps: Stages and when they ended, seconds, from the beginning on; what belongs to none has no name.
    """
    timings: dict[str, float] = {}
    before = laps[0][1]
    for stage, now in laps:
        if stage:
            timings[stage] = timings.get(stage, 0.0) + 1e3 * (now - before)
        before = now
    timings["total"] = 1e3 * (before - laps[0][1])
    return timings
