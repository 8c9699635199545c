"""Speed: the detector next to other ways from a mask to N points, and frames that show no object."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from itertools import product
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from shape_obs import metrics
from shape_obs.bench.scenes import moving_blob, moving_rope, moving_sheet
from shape_obs.camera import Intrinsics
from shape_obs.configurations.base import Configuration
from shape_obs.configurations.centerline import Centerline
from shape_obs.configurations.contour import Contour
from shape_obs.configurations.surface import Surface
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.observed import Samples
from shape_obs.geometry.polyline import nearest_on
from shape_obs.image.segmentation import GrayRange
from shape_obs.shape import Detection, Shape
from tests.benchmarks.claim import Claim, Effort, Limit
from tests.benchmarks.ropes import longest_path
from tests.benchmarks.scenes.patterns import PATTERNS
from tests.benchmarks.scenes.streams import Scene, Work, outline_pixels, work
from tests.benchmarks.tables import Row, failures, of, worst
from tests.benchmarks.timing import Method, median_ms, time_methods, times_slower

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.uint8]
Size = tuple[int, int]
WARM, COLD = "shape_obs, warm", "shape_obs, cold"
_WARM_UP: Final = 5  # frames that are not counted
_EXACT, _SAMPLED = 10_000, 2_000  # up to so many pixels the silhouette counts all; beyond, so many, each against all
_SIZES: Final[tuple[Size, ...]] = ((640, 480), (1280, 720))
SHAPES: Final[dict[str, tuple[type[Configuration], Callable[..., Iterable[Any]]]]] = {
    "centerline": (Centerline, partial(moving_rope, speed=6.0, frames=26)),
    "contour": (Contour, partial(moving_blob, turn=0.02, speed=4.0, swell=0.1, frames=26)),
    "surface": (Surface, partial(moving_sheet, speed=6.0, frames=26)),
}
INPUTS: Final = ("mask", "mask and depth", "image", "cloud")
_TRACKED: Final = 20  # good frames before the bad one
_ENOUGH: Final = 200.0  # milliseconds: what takes longer is not repeated
_REPEATS: Final = 3


def _minisom(task: Work, module: Any, scene: Scene) -> Array:
    som = module.MiniSom(*task.grid, 2, random_seed=0)
    som.random_weights_init(scene.pixels)
    som.train_random(scene.pixels, 1000)
    return som.get_weights().reshape(-1, 2)


def _kmeans(
    task: Work, module: Any, scene: Scene, *, name: str = "KMeans", ours: bool = False, **options: Any
) -> Array:
    how = {"init": scene.ours, "n_init": 1, "max_iter": 3} if ours else {"n_init": 1, "random_state": 0, **options}
    return getattr(module, name)(task.n, **how).fit(scene.pixels).cluster_centers_


def _mixture(task: Work, module: Any, scene: Scene) -> Array:
    return module.GaussianMixture(task.n, random_state=0).fit(scene.pixels).means_


def _fuzzy(task: Work, module: Any, scene: Scene) -> Array:
    samples = Samples(scene.pixels, np.ones(len(scene.pixels)), 1.0)
    return module.FuzzyCMeans().centres(samples, task.configuration.layout, 0).places


def _skeleton(task: Work, module: Any, scene: Scene) -> Array:
    return spread(longest_path(np.asarray(module.skeletonize(scene.mask > 0))), task.n)


def _contour(task: Work, module: Any, scene: Scene) -> Array:
    return spread(outline_pixels(scene.mask), task.n, closed=True)


class Peer(NamedTuple):
    """A method to compare the detector with, called as its users would.

    Args:
        module: The module that must be importable.
        run: Takes the work, the module and a scene; returns ``(N, 2)`` points.
        works: The works for which it can be used.
        slow: Whether it runs only on a few frames.
    """

    module: str
    run: Callable[[Work, Any, Scene], Array]
    works: tuple[str, ...] = ("rope", "contour", "cloth")
    slow: bool = False


PEERS: Final = {
    "minisom, 1000 iterations": Peer("minisom", _minisom),
    "K-means, n_init 1": Peer("sklearn.cluster", _kmeans),
    "K-means, n_init 10": Peer("sklearn.cluster", partial(_kmeans, n_init=10), slow=True),
    "K-means from our points, 3 iterations": Peer("sklearn.cluster", partial(_kmeans, ours=True)),
    "mini-batch K-means": Peer("sklearn.cluster", partial(_kmeans, name="MiniBatchKMeans")),
    "Gaussian mixture": Peer("sklearn.mixture", _mixture, slow=True),
    "fuzzy C-means (shape_obs)": Peer("shape_obs.clustering.fcm", _fuzzy, slow=True),
    "skeletonize, longest path": Peer("skimage.morphology", _skeleton, ("rope",)),
    "findContours, resampled": Peer("cv2", _contour, ("contour",)),
}


def spread(path: Array, n: int, *, closed: bool = False) -> Array:
    """Return (n, 2) points at equal arc length along a ``(P, 2)`` path, in the middle of equal pieces, or around it."""
    if closed:
        path = np.concatenate([path, path[:1]])
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = (np.arange(n) + (0.0 if closed else 0.5)) / n * arc[-1]
    return np.stack([np.interp(at, arc, path[:, d]) for d in range(2)], axis=1)


def point_quality(scene: Scene, points: Array, task: Work) -> tuple[float, float, float]:
    """Measure how well N points, in any order, represent the pixels of one frame; each belongs to the nearest point.

    Returns:
        The mean silhouette, -1 to 1; the Calinski-Harabasz score over all pixels; standard deviation over mean of the
        gaps between successive points along the known line, on a cloth from each point to the nearest other one, in
        percent.
    """
    pixels, labels = scene.pixels, metrics.nearest(scene.pixels, points)
    if scene.curve is None:
        gaps = np.asarray(KDTree(points).query(points, k=2)[0])[:, 1]
        spacing = float(gaps.std() / gaps.mean())
    else:
        along, _ = nearest_on(scene.curve, points)
        spacing = metrics.spacing_cv(points[np.argsort(along, kind="stable")], task.configuration.layout)
    silhouette = metrics.silhouette(pixels, labels, sample=None if len(pixels) <= _EXACT else _SAMPLED)
    return silhouette, metrics.calinski_harabasz(pixels, labels), 100 * spacing


def peers(scene: tuple[Any, int, int]) -> Iterator[Row]:
    """Run the detector and every installed peer on one work, in turns on the same frames.

    Yields:
        A row for each method: ``over ours``: times slower than the warm detector on the same frames; ``over cold``: the
        same for the cold one; SC, CH, and CH relative to the warm detector's.
    """
    name, frames, seed = scene
    task = work(name, frames + _WARM_UP, seed)
    looked_at = set((_WARM_UP + np.linspace(0, frames - 1, min(5, frames)).astype(int)).tolist())
    methods = [_detector(task, start) for start in (WARM, COLD)]
    for peer, (module, run, works, slow) in PEERS.items():
        if name in works and find_spec(module.partition(".")[0]) is not None:
            call = partial(run, task, import_module(module))
            methods.append(Method(peer, call, touch=_touch, frames=looked_at if slow else None))
    found = time_methods(task.scenes, methods, warm_up=_WARM_UP, burst=10)
    ours = 0.0
    for method, turns in found.items():
        seen = [(task.scenes[turn.frame], turn.result) for turn in turns if turn.frame in looked_at]
        sc, ch, spacing = np.mean([point_quality(each, points, task) for each, points in seen], axis=0).tolist()
        ours = ours or ch
        over, over_cold = (times_slower(turns, found[each]) for each in (WARM, COLD))
        row = {"work": name, "method": method, "frames": len(turns), "median [ms]": median_ms(turns)}
        row |= {"over ours": over, "over cold": over_cold, "SC": sc, "CH": ch, "CH over ours": ch / ours}
        yield Row(row, **{"spacing CV [%]": spacing})


def _touch(scene: Scene) -> None:
    cv2.countNonZero(scene.mask)
    scene.pixels.sum()


def _detector(task: Work, start: str) -> Method[Scene]:
    detector = ShapeDetector([task.configuration])
    before = detector.reset if start == COLD else lambda: None
    return Method(start, lambda scene: detector.detect_mask(scene.mask).shapes[0].pixels, before, _touch)


class View(NamedTuple):
    """A pattern as a detector may be given it: ``(H, W)`` mask, depth in metres and ``(H, W, 3)`` image."""

    mask: Mask
    depth: npt.NDArray[np.float32]
    rgb: Mask
    camera: Intrinsics


def view_of(mask: Mask, rng: np.random.Generator) -> View:
    """Return a mask with an image of the same pixels, and with noisy depth under it."""
    height, width = mask.shape
    depth = (0.7 + 0.002 * rng.standard_normal(mask.shape)).astype(np.float32)
    camera = Intrinsics(width, height, float(width), float(width), width / 2 - 0.5, height / 2 - 0.5)
    return View(mask, depth, np.repeat(mask[..., None], 3, axis=2), camera)


def detector_for(shape: str, given: str) -> ShapeDetector:
    """Return a detector of a configuration for one of the inputs."""
    spec = SHAPES[shape][0](lift="cloud" if given == "cloud" else "points")
    return ShapeDetector([spec], GrayRange(low=128), on_missing="hold")


def detect(detector: ShapeDetector, view: View, given: str) -> Detection:
    """Detect in one of the inputs."""
    if given == "mask":
        return detector.detect_mask(view.mask)
    if given == "image":
        return detector.detect(view.rgb, view.depth, view.camera)
    return detector.detect_mask(view.mask, view.depth, view.camera)


def worst_case(scene: tuple[Size, str, int], shapes: Sequence[str] = tuple(SHAPES)) -> Iterator[Row]:
    """Detect a pattern without a track; yield the least processor time of a frame in up to three tries."""
    size, pattern, seed = scene
    rng = np.random.default_rng([seed, list(PATTERNS).index(pattern)])
    view = view_of(PATTERNS[pattern](rng, size), rng)
    for shape, given in product(shapes, INPUTS):
        detector, taken = detector_for(shape, given), list[tuple[float, Shape]]()
        while len(taken) < _REPEATS and not (taken and taken[0][0] > _ENOUGH):
            detector.reset()
            took, found = _milliseconds(partial(detect, detector, view, given))
            taken.append((took, found.shapes[0]))
        took, found = min(taken, key=lambda each: each[0])
        yield Row(size=f"{size[0]}x{size[1]}", pattern=pattern, shape=shape, given=given, ms=took, ok=found.ok)


def hiccup(scene: tuple[str, str, str, int]) -> Row:
    """Track an object at 640 x 480 for 20 frames; then one frame is a pattern, and the object returns.

    Returns:
        ``bad_ms``: processor time of the frame with the pattern; ``after_ms``: that of the slowest of the five frames
        after it, both the least of three tries; ``ok``: whether the last frame was found.
    """
    shape, given, pattern, seed = scene
    rng, detector = np.random.default_rng(seed), detector_for(shape, given)
    good = [view_of(drawn.mask, rng) for drawn in SHAPES[shape][1](rng)]
    bad = view_of(PATTERNS[pattern](np.random.default_rng([seed, list(PATTERNS).index(pattern)]), _SIZES[0]), rng)
    taken, ok = [], False
    for _ in range(_REPEATS):
        detector.reset()
        frames = [*good[:_TRACKED], bad, *good[_TRACKED : _TRACKED + 5]]
        found = [_milliseconds(partial(detect, detector, view, given)) for view in frames]
        taken.append([took for took, _ in found[_TRACKED:]])
        ok = found[-1][1].ok and not found[-1][1].shapes[0].reason
        if taken[-1][0] > _ENOUGH:
            break
    first, *rest = np.min(taken, axis=0).tolist()
    return Row(pattern=pattern, shape=shape, given=given, bad_ms=first, after_ms=max(rest), ok=ok)


def _milliseconds(call: Callable[[], Any]) -> tuple[float, Any]:
    """Return the processor time of a call, and its result."""
    begin = time.process_time()
    result = call()
    return 1e3 * (time.process_time() - begin), result


def _some(effort: Effort, every: int = 1) -> list[str]:
    return list(PATTERNS)[:: every * max(round(1 / effort.share), 1)]


def _slowest(field: str) -> Callable[[list[Row]], str]:
    return lambda rows: max(rows, key=lambda row: row[field]).pattern


_PROTOTYPE: Final = "the target comes from a prototype that did less, and from a slower peer"
_ASKED: Final = (
    ("rope", "over ours", "minisom, 1000 iterations", 250), ("rope", "over ours", "K-means, n_init 1", 120),
    ("rope", "over ours", "K-means from our points, 3 iterations", 30), ("rope", "over cold", "K-means, n_init 1", 20),
    ("cloth", "over ours", "K-means, n_init 1", 1000), ("contour", "over ours", "K-means, n_init 1", 15),
)  # fmt: skip
_SLOW: Final = "44 ms at 640 x 480 on the slower of two processors"
CLAIMS: Final = (
    Claim(
        "speed.peers", "Time and quality of the detector and of other methods on the same masks, by turns.",
        lambda effort: product(("rope", "contour", "cloth"), [max(effort.count(100), 10)], [effort.seed]), peers,
        limits=(
            *(Limit(column, at_least=least, unit="x", where={"work": name, "method": peer}, known=_PROTOTYPE)
              for name, column, peer, least in _ASKED),
            *(Limit("CH over ours", at_most=1 / least, where={"work": name, "method": "K-means, n_init 10"})
              for name, least in (("rope", 0.995), ("contour", 0.995), ("cloth", 0.96))),
            Limit("CH over ours", at_most=1, where={"work": ("rope", "contour"), "method": "Gaussian mixture"}),
            Limit("spacing CV [%]", at_most=1, unit="%", where={"work": ("rope", "contour"), "method": WARM}),
            Limit("over ours", at_most=1, unit="x", where={"method": WARM}),
            # Half of what is seen, so that a loss of speed by half is noticed.
            Limit("over ours", at_least=10, unit="x", where={"work": "rope", "method": "K-means, n_init 1"}),
            Limit("over ours", at_least=100, unit="x", where={"work": "cloth", "method": "K-means, n_init 1"}),
        ),
        alone=True, needs=("minisom", "sklearn", "skimage"),
    ),
    Claim(
        "speed.patterns", "Processor time of a frame that shows no object, without a track, over patterns.",
        lambda effort: product(_SIZES, _some(effort), [effort.seed]), worst_case, ("size", "shape", "given"),
        {"patterns": len, "refused": failures("ok"), "worst [ms]": of(worst, "ms"), "slowest": _slowest("ms")},
        limits=(
            Limit("worst [ms]", at_most=25, unit="ms", where={"size": "640x480"}, known=_SLOW),
            Limit("worst [ms]", at_most=75, unit="ms", where={"size": "1280x720"}),
        ),
        alone=True,
    ),
    Claim(
        "speed.hiccups", "Processor time of such a frame in a tracked sequence, and of the five frames after it.",
        lambda effort: product(SHAPES, INPUTS[:3], _some(effort, 4), [effort.seed]), hiccup, ("shape", "given"),
        {"patterns": len, "not found again": failures("ok"), "bad, worst [ms]": of(worst, "bad_ms"),
         "after, worst [ms]": of(worst, "after_ms"), "slowest": _slowest("bad_ms")},
        limits=(
            Limit("bad, worst [ms]", at_most=10, unit="ms", known=_SLOW),
            Limit("after, worst [ms]", at_most=10, unit="ms"),
        ),
        alone=True,
    ),
)  # fmt: skip
