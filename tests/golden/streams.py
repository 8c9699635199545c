"""Streams and their detections: what they hold, how they are stored, and how a stream is played to a detector."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs import CameraModel, Configuration, Detection, Intrinsics, ShapeDetector, ShapeLostError

Array = npt.NDArray[Any]

DATA: Final = Path(__file__).parent / "data"
EXPECTED: Final = Path(__file__).parent / "expected"
_TENTH: Final = 1e-4  # metres: depth and clouds are stored in tenths of a millimetre
# Points are rounded to these before they are stored: much finer than the tolerances, and they compress.
_STEPS: Final = {"points2d": 2.0**-8, "points3d": 2.0**-16, "sigma": 2.0**-14, "quality": 2.0**-10}


class Truth(NamedTuple):
    """One object as it was drawn.

    Args:
        shape: The name of the configuration that looks for it.
        pixels: ``(F, P, 2)`` material points in order: along a rope from tip to tip, around an outline clockwise, or
            over a sheet row by row (P = 13 x 13); NaN in a frame without the object.
        metres: ``(F, P, 3)`` the same in the camera frame.
        hidden: ``(F, P)`` bool: covered, under another strand, or outside the image.
    """

    shape: str
    pixels: Array
    metres: Array
    hidden: Array


@dataclass(frozen=True, eq=False)
class Stream:
    """F frames and the arguments of the detector that they are shown to: as clouds, else masks, else images.

    Args:
        name: Of its files.
        arguments: The keyword arguments of ``ShapeDetector``, as JSON has them.
        stamps: ``(F,)`` seconds; NaN for a frame without one.
        masks: ``(F, H, W)`` bool; None unless given.
        depth: ``(F, H, W)`` uint16 millimetres or float32 metres; None without depth.
        rgb: ``(F, H, W, 3)`` uint8; None without pictures.
        clouds: ``(F, M, 3)`` float32 metres, unused rows 0; None unless given.
        camera: None without one.
        anchors: Name -> ``(F, 2)`` pixels or ``(F, 3)`` metres.
        truth: The objects.
        anchored: The truth's point 0 is the detector's; else the truth may be numbered from each end or corner.
    """

    name: str
    arguments: dict[str, Any]
    stamps: Array
    masks: Array | None = None
    depth: Array | None = None
    rgb: Array | None = None
    clouds: Array | None = None
    camera: CameraModel | None = None
    anchors: dict[str, Array] = field(default_factory=dict)
    truth: tuple[Truth, ...] = ()
    anchored: bool = False

    @property
    def frames(self) -> int:
        """How many frames there are."""
        return len(self.stamps)


class Outcome(NamedTuple):
    """The detections of a stream of F frames with S shapes of at most N points; NaN, 0 or "" where there is none."""

    points2d: Array  # (F, S, N, 2) float32 pixels
    points3d: Array  # (F, S, N, 3) float32 metres
    sigma: Array  # (F, S, N) float32
    visible: Array  # (F, S, N) bool
    valid: Array  # (F, S, N) bool
    ok: Array  # (F, S) bool
    new: Array  # (F, S) bool
    track_id: Array  # (F, S) int32
    quality: Array  # (F, S) float32
    age: Array  # (F, S) float32 seconds
    length: Array  # (F, S) float32 metres
    reason: Array  # (F, S) str
    notes: Array  # (F,) str: the warning, what was found beyond the count, the crossings


def names(patterns: Sequence[str] = (), known: Sequence[str] | None = None) -> list[str]:
    """Return the names of all streams, or of those that match a pattern.

    Raises:
        LookupError: A pattern that matches none; the message lists the names.
    """
    if known is None:
        known = sorted(path.stem for path in DATA.glob("*.npz"))
    found = [name for name in known if not patterns or any(fnmatchcase(name, pattern) for pattern in patterns)]
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in known):
            raise LookupError(f"no stream {pattern!r}; there are: {', '.join(known)}.")
    return found


def configurations(stream: Stream) -> tuple[Configuration, ...]:
    """Return the shapes that the stream's detector looks for, one for each slot."""
    return ShapeDetector(**stream.arguments).shapes


def play(stream: Stream) -> tuple[Outcome, float]:
    """Show a stream to a new detector; return its detections, and the milliseconds that a frame took."""
    detector, found = ShapeDetector(**stream.arguments), list[Detection | str]()
    begin = time.perf_counter()
    for frame in range(stream.frames):
        found.append(detect_frame(detector, stream, frame))
    took = (time.perf_counter() - begin) / stream.frames * 1e3
    specs = detector.shapes
    slots = {spec.name: slot for slot, spec in enumerate(specs)}
    outcome = _blank(stream.frames, len(specs), max(spec.layout.size for spec in specs))
    for frame, detection in enumerate(found):
        if isinstance(detection, str):
            outcome.notes[frame] = detection
            continue
        outcome.notes[frame] = _note(detection)
        for shape in detection:
            at, n = (frame, slots[shape.name]), len(shape)
            for name in ("points2d", "points3d", "sigma", "visible", "valid"):
                if getattr(shape, name) is not None:
                    getattr(outcome, name)[at][:n] = getattr(shape, name)
            for name in ("ok", "new", "track_id", "quality", "age", "reason"):
                getattr(outcome, name)[at] = getattr(shape, name)
            outcome.length[at] = np.nan if shape.length is None else shape.length
    return outcome, took


def detect_frame(detector: ShapeDetector, stream: Stream, frame: int) -> Detection | str:
    """Show one frame to the detector; return what it found, or the message of a ``ShapeLostError``."""
    stamp = None if np.isnan(stream.stamps[frame]) else float(stream.stamps[frame])
    anchors = {name: tuple(map(float, places[frame])) for name, places in stream.anchors.items()} or None
    mask, depth, rgb, cloud = (
        None if each is None else each[frame] for each in (stream.masks, stream.depth, stream.rgb, stream.clouds)
    )
    try:
        if cloud is not None:
            return detector.detect_cloud(cloud, camera=stream.camera, stamp=stamp, anchors=anchors)
        if mask is None:
            return detector.detect(rgb, depth, stream.camera, stamp=stamp, anchors=anchors)
        return detector.detect_mask(mask, depth, stream.camera, rgb=rgb, stamp=stamp, anchors=anchors)
    except ShapeLostError as error:
        return str(error)


def _note(detection: Detection) -> str:
    """Return what a detection says besides its shapes."""
    crossings = (f"{'/'.join(each.slots)} above {each.above} {each.handedness:+d}" for each in detection.crossings)
    more = (f"{count} more {name}" for name, count in detection.more.items())
    return "; ".join([*filter(None, [detection.warning]), *more, *crossings])


def _blank(frames: int, shapes: int, points: int) -> Outcome:
    """Return the outcome of frames in which nothing was found."""
    each, whole = (frames, shapes, points), (frames, shapes)
    empty, number, flag, text = (lambda size: np.full(size, np.nan, np.float32), np.zeros, np.bool_, "U200")
    return Outcome(
        *(empty((*each, 2)), empty((*each, 3)), empty(each), number(each, flag), number(each, flag)),
        *(number(whole, flag), number(whole, flag), number(whole, np.int32)),
        *(empty(whole), empty(whole), empty(whole), number(whole, text), number(frames, text)),
    )


def save_outcome(name: str, outcome: Outcome) -> None:
    """Store the expected detections of a stream."""
    kept = outcome._asdict()
    for key, step in _STEPS.items():
        kept[key] = (np.round(kept[key] / step) * step).astype(np.float32)
    EXPECTED.mkdir(exist_ok=True)
    np.savez_compressed(EXPECTED / f"{name}.npz", **kept)


def load_outcome(name: str) -> Outcome:
    """Read the expected detections of a stream.

    Raises:
        LookupError: There are none.
    """
    with _open(EXPECTED, name) as stored:
        return Outcome(**{key: stored[key] for key in Outcome._fields})


def save_stream(stream: Stream) -> None:
    """Store a stream: masks as bits, depth and clouds in whole numbers, the truth in single precision."""
    described: dict[str, Any] = {"arguments": stream.arguments, "anchored": stream.anchored}
    described["truth"] = [each.shape for each in stream.truth]
    kept: dict[str, Any] = {"stamps": stream.stamps, **{f"anchor_{key}": at for key, at in stream.anchors.items()}}
    if stream.masks is not None:
        described["size"] = stream.masks.shape
        kept["masks"] = np.packbits(stream.masks)
    if stream.depth is not None:
        described["metres"] = stream.depth.dtype != np.uint16
        kept["depth"] = np.round(stream.depth / _TENTH).astype(np.uint16) if described["metres"] else stream.depth
    if stream.clouds is not None:
        kept["clouds"] = np.round(stream.clouds / _TENTH).astype(np.int16)
    if stream.rgb is not None:
        kept["rgb"] = stream.rgb
    if stream.camera is not None:
        described["camera"] = stream.camera.intrinsics.to_dict()
        if stream.camera.transform_camera_to_base is not None:
            kept["transform"] = stream.camera.transform_camera_to_base
    for k, each in enumerate(stream.truth):
        kept[f"pixels{k}"] = (np.round(each.pixels * 32) / 32).astype(np.float32)
        kept[f"metres{k}"] = (np.round(each.metres * 2**14) / 2**14).astype(np.float32)
        kept[f"hidden{k}"] = each.hidden
    DATA.mkdir(exist_ok=True)
    kept["described"] = np.array(json.dumps(described))
    np.savez_compressed(DATA / f"{stream.name}.npz", **kept)


def load_stream(name: str) -> Stream:
    """Read a stream.

    Raises:
        LookupError: There is none of this name.
    """
    with _open(DATA, name) as stored:
        kept = {key: stored[key] for key in stored.files}
    described = json.loads(str(kept["described"]))
    masks = depth = clouds = camera = None
    if "masks" in kept:
        size = described["size"]
        masks = np.unpackbits(kept["masks"], count=int(np.prod(size))).reshape(size).astype(bool)
    if "depth" in kept:
        depth = (kept["depth"] * np.float32(_TENTH)).astype(np.float32) if described["metres"] else kept["depth"]
    if "clouds" in kept:
        clouds = kept["clouds"] * np.float32(_TENTH)
    if "camera" in described:
        camera = CameraModel(Intrinsics.from_dict(described["camera"]), kept.get("transform"))
    truth = [
        Truth(shape, kept[f"pixels{k}"], kept[f"metres{k}"], kept[f"hidden{k}"])
        for k, shape in enumerate(described["truth"])
    ]
    anchors = {key.removeprefix("anchor_"): at for key, at in kept.items() if key.startswith("anchor_")}
    given = (kept["stamps"], masks, depth, kept.get("rgb"), clouds, camera, anchors, tuple(truth))
    return Stream(name, described["arguments"], *given, described["anchored"])


def _open(folder: Path, name: str) -> Any:
    path = folder / f"{name}.npz"
    if not path.exists():
        raise LookupError(f"{folder.name}/{path.name} is missing: run python -m tests.golden.make {name}.")
    return np.load(path, allow_pickle=False)
