"""Clicks on drawn photos whose masks are known, and what the learned colours cost in a frame.

A user clicks in the middle of the object, then where the largest error is, on the object or not on it, until no error
is large enough to be clicked, or the last click is used up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.photos import BLUE, photographs
from shape_obs.bench.scenes import moving_rope
from shape_obs.configurations.centerline import Centerline
from shape_obs.detector import ShapeDetector
from shape_obs.frame import Frame
from shape_obs.clicks import propose_segmentation
from shape_obs.image.find_region import segment
from shape_obs.image.roi import Whole, Window
from shape_obs.image.segmentation import Segmentation
from tests.benchmarks.claim import Claim, Limit
from tests.benchmarks.scenes.object_photos import ObjectPhoto, object_photos
from tests.benchmarks.tables import Row, median, of, percent
from tests.benchmarks.timing import Method, median_ms, time_methods, timed

Pixel = tuple[float, float]
Mask = npt.NDArray[np.bool_]
Image = npt.NDArray[np.uint8]
Pixels = Sequence[Pixel]
GOOD: Final = 0.7  # intersection over union
_DEEP: Final = 1.9  # pixels from the border of an error to where it is clicked, at least
_MIDDLE: Final = 0.5  # of the largest distance from the border: how far in the middle the first click is
_WIDEST: Final = 12.0  # pixels from the border that are middle enough


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


def _ours(rgb: Image, picks: Pixels, nots: Pixels) -> Mask:
    try:
        return _seen(rgb, propose_segmentation(rgb, picks, nots).rule)
    except ValueError:  # it says that nothing stands out
        return np.zeros(rgb.shape[:2], np.bool_)


def _seen(rgb: Image, rule: Segmentation) -> Mask:
    """Return what a detector sees of an image through a rule."""
    region = segment(Frame(rgb), Window(0, 0, rgb.shape[1], rgb.shape[0]), rule, Whole())
    mask = np.zeros(rgb.shape[:2], np.bool_)
    mask[region.window.slices] = region.mask > 0
    return mask


def _grab_cut(rgb: Image, picks: Pixels, nots: Pixels) -> Mask:
    """Return what GrabCut finds if a disc around each click is certain: Rother, Kolmogorov and Blake, 2004."""
    labels = np.full(rgb.shape[:2], cv2.GC_PR_BGD, np.uint8)
    for pixels, label in ((nots, cv2.GC_BGD), (picks, cv2.GC_FGD)):
        for u, v in pixels:
            cv2.circle(labels, (round(u), round(v)), 2, label, -1)
    models: list[Any] = [np.zeros((1, 65)), np.zeros((1, 65))]
    cv2.setRNGSeed(0)
    cv2.grabCut(np.ascontiguousarray(rgb[..., ::-1]), labels, None, *models, 5, cv2.GC_INIT_WITH_MASK)  # type: ignore[arg-type]
    return (labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)


METHODS: Final[dict[str, Callable[[Image, Pixels, Pixels], Mask]]] = {"ours": _ours, "GrabCut": _grab_cut}


def click(scene: tuple[int, ObjectPhoto]) -> Iterator[Row]:
    """Segment a photo with one, two and three clicks, the same first click for all methods.

    Yields:
        A row for each method and number of clicks, for its kind of object and for "all" kinds: ``iou`` with the true
        mask; ``good`` if that is above 0.7; ``s``, the seconds it took.
    """
    number, photo = scene
    start = first_click(np.random.default_rng(number), photo.mask)
    for name, method in METHODS.items():
        picks, nots = list[Pixel](), list[Pixel]()
        found, ms = photo.mask, 0.0
        for count in (1, 2, 3):
            more = (start, True) if count == 1 else next_click(found, photo.mask)
            if more is not None:
                (picks if more[1] else nots).append(more[0])
                found, ms = timed(lambda: method(photo.rgb, picks, nots))  # noqa: B023  called at once
            iou = float(np.count_nonzero(found & photo.mask) / np.count_nonzero(found | photo.mask))
            row = Row(method=name, clicks=count, iou=iou, good=iou > GOOD, s=ms / 1e3)
            yield from (Row(row, kind=kind) for kind in ("all", photo.kind))


def frame_costs(frames: int) -> Iterator[Row]:
    """Detect a blue rope that moves on a gray table by clicked colours and by a range of hues, in turns."""
    rng = np.random.default_rng(0)
    ropes = list(moving_rope(rng, 2.0, 60))
    images = [scene.rgb for scene in photographs(rng, ropes)]
    u, v = ropes[0].curve[len(ropes[0].curve) // 2].tolist()
    rules = {"hue range": BLUE, "clicked colours": propose_segmentation(images[0], [(u, v)]).rule}
    methods: list[Method[Image]] = []
    for name, rule in rules.items():
        detector = ShapeDetector([Centerline(n=20)], rule)
        methods.append(Method(name, lambda rgb, detector=detector: detector.detect(rgb).ok))
    there_and_back = [*images, *images[::-1]]
    turns = time_methods([there_and_back[k % 120] for k in range(frames + 20)], methods, warm_up=20)
    first = median_ms(turns["hue range"])
    for name, some in turns.items():
        yield Row({"rule": name, "median [ms]": median_ms(some), "times a hue range": median_ms(some) / first})


CLAIMS: Final = (
    Claim(
        "clicks.photos", "Photos with an IoU above 0.7 after one, two and three clicks, and by other methods.",
        lambda effort: enumerate(object_photos(effort.count(280), effort.seed)), click, ("method", "clicks", "kind"),
        {"photos": len, "good [%]": percent("good"), "IoU, median": of(median, "iou"), "median [s]": of(median, "s")},
        limits=(
            Limit("good [%]", at_least=70, unit="%", where={"method": "ours", "clicks": 1, "kind": "all"}),
            Limit("good [%]", at_least=90, unit="%", sampled=85, where={"method": "ours", "clicks": 3, "kind": "all"}),
        ),
    ),
    Claim(
        "clicks.time", "A frame at 640 x 480 by clicked colours and by a range of hues.",
        lambda effort: [effort.count(300)], frame_costs,
        limits=(Limit("times a hue range", at_most=1.2, unit="x"),),
    ),
)  # fmt: skip
