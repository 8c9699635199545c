"""Log detections, images and features to the rerun viewer: https://rerun.io."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from typing import TYPE_CHECKING, Any, Final
from weakref import WeakKeyDictionary

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraLike, CameraModel
from shape_obs.drawing.pictures import GOAL, NUMBERED, PAPER, Image, point_colours, slot_colours
from shape_obs.frame import FARTHEST, MILLIMETRE, Frame
from shape_obs.image.mask_check import check_given_mask
from shape_obs.shape import Detection, Shape
from shape_obs.utils.errors import install_hint

if TYPE_CHECKING:
    from rerun.recording_stream import RecordingStream

Flags = npt.NDArray[np.bool_]
Features = Mapping[str, "Mapping[str, float] | npt.ArrayLike"]

_JPEG_QUALITY: Final = 85
_UNIX_TIME: Final = 1e9  # seconds; larger stamps are times since 1970, smaller ones since some start
_LATEST: Final = 4e9  # seconds since 1970, in 2096; larger stamps are in another unit, which rerun refuses
_FILL: Final = 0.3  # of a point of the depth cloud, so that points of the shape inside the object are seen through it
_MASK: Final = ((0, "background", (0, 0, 0, 0)), (1, "object", (60, 200, 80, 90)))
# Negative radii are in pixels of the screen.
_POINT, _FIRST, _LINE = -4.0, -6.0, -1.5

WORLD: Final = "camera"  # the camera's optical frame; its parent is the base frame
IMAGE: Final = "camera/image"  # what lies below has pixels as coordinates
PLOTS: Final = "plots"
LOG: Final = "log"

# What is remembered of streams between calls: of those that are passed, and of that of ``rerun.init`` by its id.
_own: WeakKeyDictionary[RecordingStream, RerunLog] = WeakKeyDictionary()
_global: dict[str, RerunLog] = {}


def import_rerun() -> Any:
    """Return the module ``rerun``.

    Raises:
        ImportError: It is not installed.
    """
    try:
        import rerun
    except ImportError as error:
        raise ImportError(f"the rerun viewer needs rerun-sdk: {install_hint('rerun')}") from error
    return rerun


class RerunLog:
    """Log the frames of one recording stream, and remember what rerun needs only once.

    Args:
        recording: The ``rerun.RecordingStream``; None if it is set before each call of ``log``.
        blueprint: Whether to arrange the viewer.

    Attributes:
        recording: The stream.

    Raises:
        ImportError: rerun is not installed.
    """

    def __init__(self, recording: Any, *, blueprint: bool = True) -> None:
        self._rr = import_rerun()
        self.recording = recording
        self._blueprint = blueprint
        self._frames = 0
        self._explained = False  # the colours of the mask
        self._views: frozenset[str] = frozenset()
        self._camera: CameraModel | None = None
        self._series: dict[str, tuple[str, ...]] = {}
        self._texts: dict[str, str] = {}

    def log(
        self,
        detection: Detection | None,
        rgb: Image | None = None,
        depth: npt.NDArray[Any] | None = None,
        camera: CameraLike = None,
        *,
        mask: npt.NDArray[Any] | None = None,
        features: Features | None = None,
        number: int | None = None,
        stamp: float | None = None,
        goals: Sequence[npt.NDArray[Any]] = (),
        notes: Mapping[str, str] | None = None,
    ) -> None:
        """Log a frame as ``shape_obs.log_rerun`` does.

        Args:
            detection: What was found; None logs only the images.
            rgb: As for ``log_rerun``.
            depth: As for ``log_rerun``.
            camera: As for ``log_rerun``.
            mask: As for ``log_rerun``.
            features: As for ``log_rerun``.
            number: As for ``log_rerun``.
            stamp: Seconds, for a frame without detection; a detection has its own.
            goals: Curves of ``(K, 2)`` pixels.
            notes: Texts by their subject, logged when they change; empty if all is well.

        Raises:
            TypeError: An image has another dtype.
            ValueError: An image has another shape or size.
        """
        frame = Frame(rgb, depth, camera)
        region = None if mask is None else check_given_mask(mask, frame)
        self._set_time(number, stamp if detection is None else detection.stamp)
        self._arrange(frame, detection, features)
        self._log_camera(frame.camera)
        self._log_images(frame, region)
        if goals:
            self._log(f"{IMAGE}/goals", self._rr.LineStrips2D(list(goals), colors=GOAL, radii=_LINE))
        if detection is not None:
            self._log_detection(detection)
        for name, values in (features or {}).items():
            self._log_feature(name, values)
        for subject, text in (notes or {}).items():
            self._note(subject, text, "INFO")

    def _log(self, path: str, what: Any, static: bool = False) -> None:
        self.recording.log(path, what, static=static)

    def _set_time(self, number: int | None, stamp: float | None) -> None:
        self.recording.set_time("frame", sequence=self._frames if number is None else number)
        self._frames += 1
        if stamp is not None and abs(stamp) < _LATEST:
            if stamp > _UNIX_TIME:
                self.recording.set_time("stamp", timestamp=stamp)
            else:
                self.recording.set_time("stamp", duration=stamp)

    def _arrange(self, frame: Frame, detection: Detection | None, features: Features | None) -> None:
        """Send a blueprint with views of what is logged; again when there is more to see."""
        seen = {
            "image": frame.size is not None,
            "space": frame.depth is not None or any(shape.points3d is not None for shape in detection or ()),
            "detection": detection is not None,
            "features": bool(features),
        }
        views = self._views | {name for name, there in seen.items() if there}
        if self._blueprint and views != self._views:
            self.recording.send_blueprint(layout(views))
        self._views = views

    def _log_camera(self, camera: CameraModel | None) -> None:
        """Log the intrinsics and the pose of the camera when they change."""
        if camera is None or camera is self._camera:
            return
        self._camera = camera
        lens, pose = camera.intrinsics, camera.transform_camera_to_base
        up = self._rr.ViewCoordinates
        self._log("/", up.RDF if pose is None else up.RIGHT_HAND_Z_UP, static=True)
        if pose is not None:
            self._log(WORLD, self._rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
        pinhole = self._rr.Pinhole(
            width=lens.width,
            height=lens.height,
            focal_length=(lens.fx, lens.fy),
            principal_point=(lens.cx, lens.cy),
            image_plane_distance=0.1,
        )
        self._log(IMAGE, pinhole)

    def _log_images(self, frame: Frame, mask: npt.NDArray[np.uint8] | None) -> None:
        if frame.rgb is not None:
            bgr = cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2BGR)
            _, jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
            self._log(f"{IMAGE}/rgb", self._rr.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg"))
        depth = frame.depth
        if depth is not None:
            if depth.dtype != np.uint16:  # the viewer takes 0 for unknown depth, but not NaN
                depth = np.where((depth > 0) & (depth < FARTHEST), depth, 0)
            metre = 1 / MILLIMETRE if depth.dtype == np.uint16 else 1.0
            image = self._rr.DepthImage(depth, meter=metre, colormap="grayscale", point_fill_ratio=_FILL)
            self._log(f"{IMAGE}/depth", image)
        if mask is not None:
            if not self._explained:
                self._log(f"{IMAGE}/mask", self._rr.AnnotationContext(list(_MASK)), static=True)
                self._explained = True
            self._log(f"{IMAGE}/mask", self._rr.SegmentationImage((mask > 0).astype(np.uint8)))

    def _log_detection(self, detection: Detection) -> None:
        slots = slot_colours(detection)
        for shape in detection:
            self._log_shape(shape, slots.get(shape.name))
            name = self._rr.escape_entity_path_part(shape.name)
            self._log(f"{PLOTS}/quality/{name}", self._rr.Scalars(float(shape.quality)))
            self._log(f"{PLOTS}/valid/{name}", self._rr.Scalars(float(shape.valid.mean())))
            found = "found" if shape.track_id <= 1 else f"found, track {shape.track_id}"
            self._note(shape.name, shape.reason or found, "WARN" if shape.reason else "INFO")
        if any(shape.points2d is not None for shape in detection):
            self._log_crossings(detection)
        for stage, milliseconds in detection.timings.items():
            self._log(f"{PLOTS}/timings/{stage}", self._rr.Scalars(float(milliseconds)))
        self._note("stamp", detection.warning, "WARN")
        more = (f"{count} more {name} found than there are slots" for name, count in detection.more.items())
        self._note("slots", ", ".join(more), "WARN")

    def _log_shape(self, shape: Shape, slot: tuple[int, int, int] | None) -> None:
        """Log points, numbers and lines; where a shape has no points, nothing remains of the last frame."""
        rr, name = self._rr, self._rr.escape_entity_path_part(shape.name)
        colours = np.array(point_colours(shape), np.uint8)
        edges = shape.layout.edges()
        flat = shape.points2d, f"{IMAGE}/shapes/{name}", rr.Points2D, rr.LineStrips2D
        deep = shape.points3d, f"{WORLD}/shapes/{name}", rr.Points3D, rr.LineStrips3D
        for points, path, dots, strips in (flat, deep):
            if points is None:
                continue
            known: Flags = np.asarray(np.isfinite(points).all(axis=1))
            index = np.flatnonzero(known)
            labels, radii = [str(i) for i in index], np.where(index == 0, _FIRST, _POINT)
            drawn = dots(points[known], colors=colours[known], radii=radii, labels=labels, show_labels=False)
            self._log(f"{path}/points", drawn)
            lines = points[edges[known[edges].all(axis=1)]]
            self._log(f"{path}/lines", strips(lines, colors=slot or PAPER, radii=_LINE))
            if points is shape.points2d:
                shown = index[index % (NUMBERED if slot else 1) == 0]
                texts = [shape.name if slot and i == 0 else str(i) for i in shown]
                numbers = dots(points[shown], colors=colours[shown], radii=0, labels=texts, show_labels=True)
                self._log(f"{path}/numbers", numbers)

    def _log_crossings(self, detection: Detection) -> None:
        places = [crossing.pixel for crossing in detection.crossings]
        texts = []
        for crossing in detection.crossings:
            upper, lower = crossing.slots if crossing.above != 1 else crossing.slots[::-1]
            texts.append(f"{upper} {'?' if crossing.above is None else 'over'} {lower}")
        points = self._rr.Points2D(np.reshape(places, (-1, 2)), colors=PAPER, radii=_FIRST, labels=texts)
        self._log(f"{IMAGE}/crossings", points)

    def _log_feature(self, name: str, values: Mapping[str, float] | npt.ArrayLike) -> None:
        """Log the values of a feature, and the names of its components when they change."""
        path = f"{PLOTS}/features/" + "/".join(self._rr.escape_entity_path_part(part) for part in name.split("/"))
        if isinstance(values, Mapping):
            numbers, names = np.array(list(values.values()), np.float64), tuple(values)
        else:
            numbers = np.atleast_1d(np.asarray(values, np.float64)).ravel()
            names = tuple(str(i) for i in range(len(numbers))) if len(numbers) > 1 else ("",)
        if self._series.get(name) != names:
            self._series[name] = names
            titles = [f"{name} {component}".strip() for component in names]
            self._log(path, self._rr.SeriesLines(names=titles), static=True)
        self._log(path, self._rr.Scalars(numbers))

    def _note(self, subject: str, text: str, level: str) -> None:
        """Log a text when it differs from the last one on its subject; an empty one says that all is well."""
        if self._texts.get(subject, "") != text:
            self._texts[subject] = text
            line = f"{subject}: {text or 'in order again'}"
            self._log(LOG, self._rr.TextLog(line, level=level if text else "INFO"))


def layout(views: Set[str]) -> Any:
    """Return a blueprint: the image on the left, space on the right, plots and texts below.

    Args:
        views: What there is to see: ``"image"``, ``"space"``, ``"detection"`` and ``"features"``.
    """
    import rerun.blueprint as rrb

    upper: list[Any] = []
    if "image" in views:
        contents = ["$origin/**", "- $origin/depth"]
        upper.append(rrb.Spatial2DView(origin=f"/{IMAGE}", name="image", contents=contents))
    if "space" in views:
        flat = [f"- /{IMAGE}/{name}/**" for name in ("shapes", "mask", "crossings", "goals")]
        upper.append(rrb.Spatial3DView(origin="/", name="space", contents=[f"/{WORLD}/**", *flat]))
    lower: list[Any] = []
    hidden = rrb.PlotLegend(visible=False)  # it would cover the lines; the pointer shows their names
    if "detection" in views:
        quality = [f"/{PLOTS}/quality/**", f"/{PLOTS}/valid/**"]
        lower.append(rrb.TimeSeriesView(origin=f"/{PLOTS}", name="quality and valid share", contents=quality))
        lower.append(rrb.TimeSeriesView(origin=f"/{PLOTS}/timings", name="milliseconds by stage"))
    if "features" in views:
        lower.append(rrb.TimeSeriesView(origin=f"/{PLOTS}/features", name="features", plot_legend=hidden))
    if lower:
        lower.append(rrb.TextLogView(origin=f"/{LOG}", name="reasons"))
    rows = [rrb.Horizontal(*part) for part in (upper, lower) if part]
    container = rrb.Vertical(*rows, row_shares=[3, 1][: len(rows)]) if rows else rrb.Vertical()
    return rrb.Blueprint(container, rrb.TimePanel(state="collapsed"), collapse_panels=True)


def log_rerun(
    detection: Detection | None,
    rgb: Image | None = None,
    depth: npt.NDArray[Any] | None = None,
    camera: CameraLike = None,
    *,
    mask: npt.NDArray[Any] | None = None,
    features: Features | None = None,
    number: int | None = None,
    recording: RecordingStream | None = None,
    blueprint: bool = True,
) -> None:
    """Log a frame and its detection to rerun.

    The page "See it in rerun" lists the entities. Call it once per frame, from one thread::

        rerun.init("my_robot", spawn=True)
        while True:
            rgb, depth = read_camera()
            shape_obs.log_rerun(detector.detect(rgb, depth, camera), rgb, depth, camera)

    Args:
        detection: What was found; None logs only the images.
        rgb: ``(H, W, 3)`` uint8, RGB; logged as JPEG.
        depth: ``(H, W)`` uint16 millimetres or floating metres, aligned to ``rgb``.
        camera: As for ``ShapeDetector.detect``. With a pose, everything in 3D is shown in the base frame, else in the
            camera's optical frame.
        mask: ``(H, W)`` bool or uint8, 0 = background.
        features: Values by name, plotted over time: ``{"rope/length": 0.41}``, an array of values, or values by the
            names of their components, as ``FeatureVector.named`` returns them.
        number: Number of the frame on the timeline ``frame``; None counts the calls.
        recording: The stream to log to; None for that of ``rerun.init``.
        blueprint: Whether to arrange the viewer at the first call; False keeps your own blueprint.

    Raises:
        ImportError: rerun is not installed; the extra ``rerun`` installs it.
        TypeError: An image has another dtype.
        ValueError: An image has another shape or size, or there is no recording yet.
    """
    log, stream = _log_of(recording, blueprint)
    log.recording = stream
    try:
        log.log(detection, rgb, depth, camera, mask=mask, features=features, number=number)
    finally:
        log.recording = None  # nothing but the caller keeps a stream open, so that its file is complete when it is gone


def _log_of(recording: RecordingStream | None, blueprint: bool) -> tuple[RerunLog, RecordingStream]:
    """Return what is remembered of a stream, and the stream; rerun makes a new object of the global one at each call.

    Raises:
        ValueError: There is no recording yet.
    """
    if recording is not None and recording in _own:
        return _own[recording], recording
    shared = import_rerun().get_global_data_recording()
    stream = shared if recording is None else recording
    if stream is None:
        raise ValueError('log_rerun: there is no rerun recording; call rerun.init("my_app", spawn=True) first.')
    key = _recording_id(stream)
    if recording is not None and (shared is None or _recording_id(shared) != key):
        _own[recording] = RerunLog(None, blueprint=blueprint)
        return _own[recording], recording
    if key not in _global:
        _global.clear()  # there is one at a time
        _global[key] = RerunLog(None, blueprint=blueprint)
    return _global[key], stream


def _recording_id(stream: RecordingStream) -> str:
    """Return the id of a stream, which older versions of rerun return by a function."""
    if hasattr(stream, "get_recording_id"):
        return str(stream.get_recording_id())
    return str(import_rerun().get_recording_id(stream))
