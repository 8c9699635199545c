"""The call that logs a frame to rerun in a loop of one's own."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy.typing as npt

from shape_obs.camera import CameraModel, Intrinsics
from shape_obs.drawing.pictures import Image
from shape_obs.drawing.rerun_log import Features, RerunLog, import_rerun
from shape_obs.shape import Detection

if TYPE_CHECKING:
    from rerun.recording_stream import RecordingStream

# What is remembered of streams between calls: of those that are passed, and of that of ``rerun.init`` by its id.
_own: WeakKeyDictionary[RecordingStream, RerunLog] = WeakKeyDictionary()
_global: dict[str, RerunLog] = {}


def log_rerun(
    detection: Detection | None,
    rgb: Image | None = None,
    depth: npt.NDArray[Any] | None = None,
    camera: CameraModel | Intrinsics | None = None,
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
        camera: Intrinsics, or a camera model. With a pose, everything in 3D is shown in the base frame, else in the
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
