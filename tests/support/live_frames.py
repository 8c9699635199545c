"""Run one configuration over drawn scenes, and print which compiled functions it called, and which too late.

``python live_frames.py centerline`` prints a JSON object: ``called`` and ``listed`` (names), ``late`` (those
that were compiled or loaded after the detector had been constructed), and ``ok`` (how many shapes were found).
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np
from numba.core import event

from shape_obs import Centerline, Contour, HSVRange, Intrinsics, ShapeDetector, Surface
from shape_obs.bench.photos import photographed
from shape_obs.bench.scenes import moving_blob, moving_rope, moving_sheet
from shape_obs.compiled import decorator
from shape_obs.configurations.shape_points import SHAPE_FUNCTIONS
from shape_obs.geometry.polyline import nearest_along
from shape_obs.image.find_region import prepare
from shape_obs.tracking.speed_gate import TRACK_FUNCTIONS
from tests.scenes.blobs import random_blob
from tests.scenes.clouds import moving_rope_cloud, ring_cloud, rope_cloud, sheet_cloud
from tests.scenes.flat_objects import View, cloth, ring, under_hand
from tests.scenes.hidden_ropes import hidden_rope
from tests.scenes.ropes import random_rope
from tests.scenes.sheets import random_sheet
from tests.scenes.tangles import crossing_rope, cut_rope

BLUE = HSVRange(low=(100, 80, 25), high=(130, 255, 255))
CAMERA = Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)
LENS = Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5, "brown_conrady", (0.02, 0.0, 0.0, 0.0, 0.0))
CLASSES: dict[str, type] = {"centerline": Centerline, "contour": Contour, "surface": Surface}


class Late(event.Listener):
    """Collects the names of functions that are compiled or loaded."""

    def __init__(self) -> None:
        self.names: set[str] = set()

    def on_start(self, event: Any) -> None:
        self.names.add(event.data["dispatcher"].py_func.__name__)

    def on_end(self, event: Any) -> None:
        pass


def counted(function: Any, called: set[str]) -> Callable[..., Any]:
    @wraps(function.py_func)
    def wrapper(*args: Any, **kwargs: Any) -> Any:
        called.add(function.py_func.__name__)
        return function(*args, **kwargs)

    return wrapper


def watch() -> tuple[set[str], set[str]]:
    """Watch every compiled function; return the names of those that are called, and of those that were not ready."""
    late, called = Late(), set[str]()
    event.register("numba:compile", late)
    first_call = decorator._EntryPoint.__call__

    def too_late(entry: Any, *args: Any, **kwargs: Any) -> Any:
        late.names.add(entry.py_func.__name__)
        return first_call(entry, *args, **kwargs)

    setattr(decorator._EntryPoint, "__call__", too_late)  # noqa: B010 - pyright does not allow a plain assignment
    for name, module in list(sys.modules.items()):
        if name.startswith("shape_obs."):
            for attribute, value in list(vars(module).items()):
                if isinstance(value, decorator._Dispatcher):
                    setattr(module, attribute, counted(value, called))
    return called, late.names


def centerline_masks() -> list[list[np.ndarray]]:
    rng = np.random.default_rng(3)
    hidden = [[h.mask for h in hidden_rope(rng, 6, 0.25, where, frames=25)] for where in ("start", "middle")]
    tangles = [crossing_rope(rng, 1), crossing_rope(rng, 2), cut_rope(rng, 1, 16)]
    refused = [random_blob(rng).mask, random_sheet(rng, 1.5, 20.0).mask, rng.integers(0, 2, (480, 640), np.uint8)]
    tracked = [rope.mask for rope in moving_rope(rng, 6, 20)]
    cut = [np.where(np.arange(640) < 620 - 10 * k, mask, 0).astype(np.uint8) for k, mask in enumerate(tracked)]
    lost = [tracked[0], *[np.zeros((480, 640), np.uint8)] * 40, tracked[0]]  # for longer than ``max_age``
    return [*hidden, *[[t.mask] for t in tangles], tracked, cut, [tracked[0][:, ::-1], tracked[1] > 0], refused, lost]


def contour_masks() -> list[list[np.ndarray]]:
    rng = np.random.default_rng(1)
    blobs = [b.mask for b in moving_blob(rng, turn=0.1, speed=6, swell=0.3, frames=20)]
    rope, band = random_rope(rng, "loop").mask, np.zeros((480, 640), np.uint8)
    band[100:380, 150:500], band[160:320, 210:440] = 255, 0
    hand = [scene.mask for scene in under_hand(rng, ring(rng, True), View(), "side", 16.0, level=True)][:12]
    return [blobs, [random_blob(rng).mask], [blobs[0][:, ::-1]], [rope], [band] * 3, [b[:, :320] for b in blobs], hand]


def surface_masks() -> list[list[np.ndarray]]:
    rng = np.random.default_rng(4)
    sheets = [s.mask for s in moving_sheet(rng, 8, 20)]
    return [
        sheets,
        [scene.mask for scene in under_hand(rng, cloth(1.0), View(), "corner", 16.0, level=True)][:12],
        [random_sheet(rng, 1.5, 70.0).mask],
        [sheets[0][::-1]],
        [random_blob(rng).mask],
        [random_rope(rng).mask],
    ]


def main(kind: str) -> None:
    make = CLASSES[kind]
    holes = [make(hole=0)] if kind == "contour" else [make(epochs=1)] if kind == "surface" else [make(ends="centers")]
    holes += [make(ring=True)] if kind == "contour" else []
    specs = [make(), make(order="image"), *holes, make(lift="cloud"), make(spacing="m")]
    detectors = [ShapeDetector([spec], BLUE) for spec in specs]
    kmeans = ShapeDetector([make()], BLUE, clustering="kmeans")
    masks = {"centerline": centerline_masks, "contour": contour_masks, "surface": surface_masks}[kind]()
    ring_under_hand = under_hand(np.random.default_rng(1), ring(np.random.default_rng(1), True), View(), "side", 16.0)
    in_depth = list(ring_under_hand) if kind == "contour" else []
    called, late = watch()
    rng, ok = np.random.default_rng(0), 0
    for spec, detector in zip(specs, detectors, strict=True):
        in_space = spec.lift == "cloud" or spec.spacing == "m"
        for scene in [scene[:8] for scene in masks[:2]] if in_space else masks:
            detector.reset()
            for mask in scene:
                depth: Any = rng.integers(695, 705, mask.shape, np.uint16)
                ok += detector.detect_mask(mask, *([depth, CAMERA] if in_space else [])).shapes[0].ok
        if in_space:  # what has depth here and there only is not measured in space
            detector.reset()
            sparse = np.where(rng.random(masks[0][0].shape) < 0.05, 700, 0).astype(np.uint16)
            detector.detect_mask(masks[0][0], sparse, CAMERA)
        if spec.spacing == "m":
            detector.reset()
            for scene in in_depth:
                ok += detector.detect_mask(scene.mask, scene.depth, View().intrinsics).shapes[0].ok
    for mask in masks[0][:5]:
        kmeans.detect_mask(mask, np.full(mask.shape, 700, np.uint16), CAMERA)
    if kind == "contour":
        ShapeDetector([make(hole=0)], BLUE, clustering="kmeans").detect_mask(masks[4][0])
    detector = detectors[0]
    detector.reset()
    for k, mask in enumerate(masks[0][:12]):
        image = photographed(rng, mask, 1.5, 4.0)
        depth = rng.integers(695, 705, mask.shape, np.uint16)
        if k == 5:
            depth[:, : int(np.flatnonzero(mask.any(axis=0)).mean())] = 0  # half of the object has no depth
        if k == 6:
            depth[:, int(np.flatnonzero(mask.any(axis=0)).mean()) - 20 :] = 0  # and here most of it
        if k % 2:
            depth, image = depth.astype(np.float64) / 1000, image[:, ::-1][:, ::-1]
        ok += detector.detect(image, depth, CAMERA if k < 9 else LENS).shapes[0].ok
    clouds = [rope_cloud(rng).points, ring_cloud(rng).points, sheet_cloud(rng).points]
    clouds += [frame.points for frame in moving_rope_cloud(rng, 0.01, frames=3)]
    for cloud in [*clouds, clouds[2] + 1e-4, clouds[1] + 1e-4]:
        ok += detectors[0].detect_cloud(cloud).shapes[0].ok
        ok += kind == "surface" and detectors[2].detect_cloud(cloud).shapes[0].ok
    rules = [spec.segmentation for spec in detector.shapes]
    fits = {function for one in detectors for function in one.shapes[0].compiled_functions}
    sorting = [] if kind == "surface" else [nearest_along]  # of the K-means' centres, along a curve
    listed = [*prepare(rules), *SHAPE_FUNCTIONS, *TRACK_FUNCTIONS, *fits, *sorting]
    names = sorted(function.__name__ for function in listed)
    print(json.dumps({"called": sorted(called), "listed": names, "late": sorted(late), "ok": int(ok)}))


if __name__ == "__main__":
    main(sys.argv[1])
