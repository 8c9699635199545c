"""Measure how well clicks segment drawn photos whose masks are known, and what the learned colours cost in a frame.

A user clicks in the middle of the object, then where the largest error is, on the object or not on it, until no error
is large enough to be clicked, or the last click is used up.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.configurations.centerline import Centerline
from shape_obs.detector import ShapeDetector
from shape_obs.frame import Frame
from shape_obs.image.colour_picker import propose_segmentation
from shape_obs.image.find_region import segment
from shape_obs.image.roi import Whole, Window
from shape_obs.image.segmentation import Segmentation
from tests.benchmarks.click_peers import grab_cut, hsv_range
from tests.benchmarks.interleaved_timing import Method, Timing, median_ms, time_methods
from tests.benchmarks.scenes.object_photos import ObjectPhoto
from tests.benchmarks.tables import Row, at_least, at_most, of, summary

Pixel = tuple[float, float]
Mask = npt.NDArray[np.bool_]
Image = npt.NDArray[np.uint8]
Segment = Callable[[Image, Sequence[Pixel], Sequence[Pixel]], Mask]

GOOD: Final = 0.7  # intersection over union
_CLICKS: Final = 3
_DEEP: Final = 1.9  # pixels from the border of an error to where it is clicked, at least
_MIDDLE: Final = 0.5  # of the largest distance from the border: how far in the middle the first click is
_WIDEST: Final = 12.0  # pixels from the border that are middle enough


def by_clicks(photos: Iterable[ObjectPhoto], clicks: int = _CLICKS, *, peers: bool = True) -> Iterator[Row]:
    """Segment photos with one click and more, the same first click for all methods.

    Returns:
        A row for each photo, method and number of clicks: ``kind``, ``ground``, ``similar``, ``method``, ``clicks``;
        ``iou`` with the true mask; ``good`` if that is above 0.7; ``s``, the seconds it took.
    """
    methods: dict[str, Segment] = {"ours": _ours}
    if peers:
        methods |= {"one hue range": _one_range, "GrabCut": grab_cut}
    for k, photo in enumerate(photos):
        start = first_click(np.random.default_rng(k), photo.mask)
        for name, method in methods.items():
            picks, nots = list[Pixel](), list[Pixel]()
            found, seconds = photo.mask, 0.0
            for count in range(1, clicks + 1):
                more = (start, True) if count == 1 else next_click(found, photo.mask)
                if more is not None:
                    (picks if more[1] else nots).append(more[0])
                    begin = time.perf_counter()
                    found = method(photo.rgb, picks, nots)
                    seconds = time.perf_counter() - begin
                iou = float(np.count_nonzero(found & photo.mask) / np.count_nonzero(found | photo.mask))
                yield Row(
                    kind=photo.kind, ground=photo.ground, similar=photo.similar, method=name, clicks=count, iou=iou,
                    good=iou > GOOD, s=seconds,
                )  # fmt: skip


def first_click(rng: np.random.Generator, mask: Mask) -> Pixel:
    """Return a pixel (u, v) in the middle of an object."""
    depth = _depth(mask)
    rows, columns = np.nonzero(depth >= max(1.0, _MIDDLE * min(float(depth.max()), _WIDEST)))
    k = int(rng.integers(len(rows)))
    return float(columns[k]), float(rows[k])


def next_click(found: Mask, truth: Mask) -> tuple[Pixel, bool] | None:
    """Return the middle of the largest error and whether it is on the object; None if no error is large enough."""
    best, largest = None, 0
    for error, on in ((truth & ~found, True), (found & ~truth, False)):
        count, labels, stats, _ = cv2.connectedComponentsWithStats(error.view(np.uint8))
        depth, deepest = _depth(error), np.zeros(count)
        np.maximum.at(deepest, np.asarray(labels, np.int32).ravel(), depth.ravel())
        areas = np.where(deepest >= _DEEP, stats[:, cv2.CC_STAT_AREA], 0)
        areas[0] = 0
        k = int(np.argmax(areas))
        if areas[k] > largest:
            v, u = np.unravel_index(int(np.where(labels == k, depth, 0).argmax()), error.shape)
            best, largest = ((float(u), float(v)), on), areas[k]
    return best


def _depth(mask: Mask) -> npt.NDArray[np.float32]:
    """Return the distance of each pixel from the border of a mask; the image's border counts as one."""
    padded = np.pad(mask, 1).astype(np.uint8)
    return np.asarray(cv2.distanceTransform(padded, cv2.DIST_L2, 5), np.float32)[1:-1, 1:-1]


def _ours(rgb: Image, picks: Sequence[Pixel], nots: Sequence[Pixel]) -> Mask:
    try:
        return _seen(rgb, propose_segmentation(rgb, picks, nots).rule)
    except ValueError:  # it says that nothing stands out
        return np.zeros(rgb.shape[:2], np.bool_)


def _one_range(rgb: Image, picks: Sequence[Pixel], nots: Sequence[Pixel]) -> Mask:
    return _seen(rgb, hsv_range(rgb, picks[0]))


def _seen(rgb: Image, rule: Segmentation) -> Mask:
    """Return what a detector sees of an image through a rule."""
    whole = Window(0, 0, rgb.shape[1], rgb.shape[0])
    region = segment(Frame(rgb), whole, rule, Whole())
    mask = np.zeros(rgb.shape[:2], np.bool_)
    mask[region.window.slices] = region.mask > 0
    return mask


def click_table(rows: Iterable[Row]) -> list[Row]:
    """Return the share of photos that are segmented well, by method, clicks and kind of object, and of all kinds."""
    columns = {
        "photos": len,
        "good": of(lambda values: float(np.mean(values)), "good"),
        "iou": of(lambda values: float(np.median(values)), "iou"),
        "s": of(lambda values: float(np.median(values)), "s"),
    }
    found = list(rows)
    whole = [Row(row, kind="all") for row in found]
    return summary([*whole, *found], ("method", "clicks", "kind"), columns)


def frame_costs(frames: int, seed: int = 0) -> list[Row]:
    """Detect a rope in the same images by clicked colours and by a range of hues; ``ms`` per frame and their ratio."""
    images = _swaying(frames)
    pixel = (320.0, 240.0)
    rules = {"hue range": hsv_range(images[0], pixel), "clicked colours": propose_segmentation(images[0], [pixel]).rule}
    methods = [Method(name, _detect(rule)) for name, rule in rules.items()]
    turns = time_methods(images, methods, Timing(seed=seed), warm_up=20)
    times = {name: median_ms(some) for name, some in turns.items()}
    return [Row(rule=name, ms=ms, to_hue_range=ms / times["hue range"]) for name, ms in times.items()]


def _detect(rule: Segmentation) -> Callable[[Image], bool]:
    detector = ShapeDetector([Centerline(n=20)], rule)
    return lambda rgb: detector.detect(rgb).ok


def _swaying(frames: int) -> list[Image]:
    """Return images of a blue rope that sways on a gray table."""
    rng, images = np.random.default_rng(0), []
    ground = np.clip(rng.normal(190, 4, (480, 640, 3)), 0, 255)
    for k in range(frames + 20):
        along = np.linspace(60, 580, 200)
        curve = np.stack([along, 240 + 4 * np.sin(k / 9) * np.sin((along - 320) / 60)], axis=1)
        image = ground.copy()
        cv2.polylines(image, [np.round(curve * 16).astype(np.int32)], False, (30.0, 70.0, 170.0), 13, cv2.LINE_AA, 4)
        images.append(image.astype(np.uint8))
    return images


def targets(rows: Iterable[Row], costs: Iterable[Row]) -> list[Row]:
    """Return what was asked of clicks, and what was seen."""
    shares = {(row.method, row.clicks): row.good for row in rows if row.kind == "all"}
    ratio = next((row.to_hue_range for row in costs if row.rule == "clicked colours"), None)
    return [
        at_least("photos with IoU > 0.7 after one click", 0.7, shares.get(("ours", 1)), ""),
        at_least("photos with IoU > 0.7 after three clicks", 0.9, shares.get(("ours", 3)), ""),
        at_most("a frame by clicked colours, in frames by a range of hues", 1.2, ratio),
    ]
