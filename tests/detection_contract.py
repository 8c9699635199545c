"""The contract of every ``Detection``, against which fixtures of ``conftest`` hold each detection of each test.

The promises are those of the docstrings of ``Shape`` and ``Detection``. What is broken is collected instead of raised,
so that no code under test can swallow it.
"""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final
from weakref import WeakKeyDictionary

import numpy as np
import pytest

from shape_obs import Detection, Shape, ShapeDetector

_STAGES: Final = {"roi", "segmentation", "region", "cloud", "fit", "lift", "total"}
_FLOAT, _FLAG = np.dtype(np.float32), np.dtype(np.bool_)
_ARRAYS: Final = (
    ("points2d", _FLOAT, (2,)), ("points3d", _FLOAT, (3,)), ("visible", _FLAG, ()), ("valid", _FLAG, ()),
    ("sigma", _FLOAT, ()),
)  # fmt: skip

#: Of each detector, by name: the track in which a shape was last found since the last reset.
Tracks = dict[str, int]
_tracks: WeakKeyDictionary[ShapeDetector, Tracks] = WeakKeyDictionary()


def broken_shape(shape: Shape, size: int, *, in_2d: bool, in_3d: bool, diagonal: float = math.inf) -> list[str]:
    """Return what a shape of ``size`` points breaks; ``diagonal`` is the image's in pixels."""
    for name, dtype, rest in _ARRAYS:
        array = getattr(shape, name)
        if array is None:
            continue
        if array.dtype != dtype or array.shape != (size, *rest):
            return [f"{name} is {array.dtype} {array.shape}"]
        if array.flags.writeable:
            return [f"{name} is writable"]
    points2d, points3d, visible, valid = shape.points2d, shape.points3d, shape.visible, shape.valid
    found, sigma, any_visible, any_valid = not shape.reason, shape.sigma, bool(visible.any()), bool(valid.any())
    broken = []
    if (points2d is not None) != in_2d:
        broken.append("points2d for images only")
    if points2d is not None and not math.isfinite(points2d.sum()):
        if shape.ok:
            broken.append("points2d finite if ok")
        if not np.isnan(points2d).all():
            broken.append("points2d finite, or all of it NaN")
    if found and (points3d is not None) != in_3d:
        broken.append("points3d with depth and a camera only")
    if points3d is not None:
        if not math.isfinite(points3d.sum()) and np.isinf(points3d).any():
            broken.append("points3d never infinite")
        if any_valid and not math.isfinite(points3d[valid].sum()):
            broken.append("points3d finite where valid")
        if any_valid and in_2d and not points3d[valid, 2].min() > 0:
            broken.append("points3d in front of the camera")
    elif found and (visible != valid).any():
        broken.append("without depth, valid where visible")
    if any_valid and (valid > visible).any():
        broken.append("valid where visible only")
    if any_visible and not found:
        broken.append("nothing visible with a reason")
    if not 0 <= shape.quality <= 1 or (shape.reason and shape.quality):
        broken.append("quality in 0...1, and 0 with a reason")
    if not 0 <= shape.age < math.inf or (found and shape.age):
        broken.append("age finite, at least 0, and 0 without a reason")
    if found and not shape.ok:
        broken.append("ok, or a reason")
    if not (sigma.min() >= 0 and sigma.max() <= (diagonal * 1.0001 if points3d is None else 1)):
        broken.append(f"sigma from 0 to its bound, not {sigma.min()} to {sigma.max()}")
    if shape.track_id < 0 or (shape.ok and not shape.track_id):
        broken.append("a track if ok")
    if shape.new and not found:
        broken.append("new only if found")
    if shape.length is not None and not 0 < shape.length < math.inf:
        broken.append("a length above 0")
    return broken


def broken_tracks(shapes: tuple[Shape, ...], tracks: Tracks | None) -> list[str]:
    """Return what shapes break of how tracks are numbered; ``tracks`` are those before, None if unknown."""
    broken = []
    for shape in shapes if tracks is not None else ():
        assert tracks is not None
        before = tracks.get(shape.name, 0)
        if shape.reason:
            if shape.track_id not in (0, before):
                broken.append(f"{shape.name}: was not found, and its track {before} is {shape.track_id}")
        elif shape.track_id < before or shape.new != (shape.track_id != before):
            broken.append(f"{shape.name}: track {before}, then {shape.track_id}, new={shape.new}")
    return broken


def broken_detection(
    detection: Detection, detector: ShapeDetector, *, in_2d: bool, in_3d: bool, diagonal: float, stamp: float | None
) -> list[str]:
    """Return what a detection breaks, and its shapes."""
    specs, timings = detector.shapes, detection.timings
    names = [shape.name for shape in detection.shapes]
    if any(spec.count == "all" for spec in detector.config.shapes):  # a slot is opened for each that is found
        specs = tuple(spec for spec in specs if spec.name in names)
    if names != [spec.name for spec in specs]:
        return [f"shapes in the order of the configurations and their slots, not {names}"]
    broken = [
        f"{shape.name} ({spec.kind}): {what}"
        for shape, spec in zip(detection.shapes, specs, strict=True)
        for what in broken_shape(shape, spec.layout.size, in_2d=in_2d, in_3d=in_3d, diagonal=diagonal)
    ]
    total = timings.get("total", -1.0)
    if not timings.keys() <= _STAGES or min(timings.values()) < 0 or sum(timings.values()) > 2 * total + 1e-6:
        broken.append(f"timings by stage, and their total: {timings}")
    if not math.isfinite(detection.stamp) or (stamp is not None and detection.stamp != float(stamp)):
        broken.append(f"the frame's stamp {stamp}, not {detection.stamp}")
    if detection.more and min(detection.more.values()) < 1:
        broken.append(f"more than the count, or no entry: {detection.more}")
    broken += [
        f"crossings between shapes of the detection: {each}"
        for each in detection.crossings
        if not set(each.slots) <= set(names) or not 0 <= min(each.arcs) <= max(each.arcs) <= 1
    ]
    return broken


@contextmanager
def watched() -> Iterator[list[str]]:
    """Hold every detection made in the block against the contract; give the list to which broken promises are added."""
    broken: list[str] = []

    def watch(method: Any, of_cloud: bool) -> Any:
        names = list(inspect.signature(method).parameters)[1:4]  # the first is the image, the mask or the cloud

        @functools.wraps(method)
        def call(self: ShapeDetector, *args: Any, **options: Any) -> Detection:
            tracks = _tracks.pop(self, None)  # an exception leaves them unknown
            detection = method(self, *args, **options)
            given = {**dict(zip(names, args, strict=False)), **options}
            depth, image = given.get("depth"), given[names[0]]
            shown: Any = depth if image is None else image
            height, width = (0, 0) if of_cloud else np.shape(shown)[:2]
            in_3d = of_cloud or (depth is not None and given.get("camera") is not None)
            what = {"in_2d": not of_cloud, "in_3d": in_3d, "diagonal": math.hypot(width, height)}
            broken.extend(broken_detection(detection, self, stamp=given.get("stamp"), **what))
            broken.extend(broken_tracks(detection.shapes, tracks))
            if tracks is not None:
                tracks.update((shape.name, shape.track_id) for shape in detection.shapes if not shape.reason)
                _tracks[self] = tracks
            return detection

        return call

    def reset(self: ShapeDetector) -> None:
        forget(self)
        _tracks[self] = {}

    forget = ShapeDetector.reset
    with pytest.MonkeyPatch.context() as patch:
        for name in ("detect", "detect_mask", "detect_cloud"):
            patch.setattr(ShapeDetector, name, watch(getattr(ShapeDetector, name), name == "detect_cloud"))
        patch.setattr(ShapeDetector, "reset", functools.wraps(forget)(reset))
        yield broken
