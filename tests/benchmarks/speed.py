"""Speed: the detector next to other ways from a mask to N points, and frames that show no object."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from itertools import product
from typing import Any, Final

import numpy as np

from shape_obs import metrics
from shape_obs.camera import Intrinsics
from shape_obs.configurations.centerline import Centerline
from shape_obs.configurations.contour import Contour
from shape_obs.configurations.surface import Surface
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.polyline import arc_length, interpolate, nearest_on
from shape_obs.image.segmentation import GrayRange
from shape_obs.shape import Detection
from tests.benchmarks.claim import Claim, Limit
from tests.benchmarks.ropes import longest_path
from tests.benchmarks.scenes.patterns import PATTERNS
from tests.benchmarks.scenes.streams import Scene, Work, outline_pixels, work
from tests.benchmarks.tables import Row, of, total, worst
from tests.benchmarks.timing import Method, median_ms, time_methods, timed

WARM, COLD = "shape_obs, warm", "shape_obs, cold"
_WARM_UP: Final = 5  # frames that are not counted
_SAMPLED: Final = 2000  # pixels that the silhouette counts, each against all
SIZES: Final = ((640, 480), (1280, 720))
_ENOUGH: Final = 200.0  # milliseconds: what takes longer is not repeated
_REPEATS: Final = 3


def methods(task: Work, few: set[int]) -> Iterator[Method[Scene]]:
    """Return the detector and what may be used in its place, called as its users would; slow ones see few frames."""
    from minisom import MiniSom
    from skimage.morphology import skeletonize
    from sklearn.cluster import KMeans
    from sklearn.mixture import GaussianMixture

    n = task.n
    warm, cold = (ShapeDetector([task.configuration]) for _ in range(2))

    def detected(scene: Scene, detector: ShapeDetector) -> Any:
        if detector is cold:
            cold.reset()
        return detector.detect_mask(scene.mask).shapes[0].pixels

    def mapped(scene: Scene) -> Any:
        som = MiniSom(*task.grid, 2, random_seed=0)
        som.random_weights_init(scene.pixels)
        som.train_random(scene.pixels, 1000)
        return som.get_weights().reshape(-1, 2)

    def means(scene: Scene, **options: Any) -> Any:
        return KMeans(n, **{"n_init": 1, "random_state": 0, **options}).fit(scene.pixels).cluster_centers_

    def thinned(scene: Scene) -> Any:
        path = longest_path(np.asarray(skeletonize(scene.mask > 0)))
        arc = arc_length(path)
        return interpolate(path, arc, (np.arange(n) + 0.5) / n * arc[-1])

    def traced(scene: Scene) -> Any:
        outline = outline_pixels(scene.mask)
        outline = np.concatenate([outline, outline[:1]])
        arc = arc_length(outline)
        return interpolate(outline, arc, np.arange(n) / n * arc[-1])

    yield Method(WARM, partial(detected, detector=warm))
    yield Method(COLD, partial(detected, detector=cold))
    yield Method("minisom, 1000 iterations", mapped)
    yield Method("K-means, n_init 1", means)
    yield Method("K-means, n_init 10", partial(means, n_init=10), few)
    yield Method("K-means from our points, 3 iterations", lambda scene: means(scene, init=scene.ours, max_iter=3))
    yield Method("Gaussian mixture", lambda scene: GaussianMixture(n, random_state=0).fit(scene.pixels).means_, few)
    if task.name == "rope":
        yield Method("skeletonize, longest path", thinned)
    if task.name == "contour":
        yield Method("findContours, resampled", traced)


def peers(works: tuple[Any, int, int]) -> Iterator[Row]:
    """Run the detector and every other method on one work, in turns on the same frames.

    Yields:
        A row for each method: ``over ours``: median time over that of the warm detector; ``over cold``: the same for
        the cold one; SC and CH, where each pixel belongs to the nearest point, and CH relative to the warm detector's;
        standard deviation over mean of the gaps between successive points along the known line.
    """
    name, frames, seed = works
    task = work(name, frames + _WARM_UP, seed)
    looked_at = set((_WARM_UP + np.linspace(0, frames - 1, min(5, frames)).astype(int)).tolist())

    def in_cache() -> Iterator[Scene]:
        for each in task.scenes:
            each.mask.sum()
            each.pixels.sum()
            yield each

    found = time_methods(in_cache(), list(methods(task, looked_at)), warm_up=_WARM_UP, burst=10)
    ours = 0.0
    for method, turns in found.items():
        quality = []
        for scene, points in ((task.scenes[turn.frame], turn.result) for turn in turns if turn.frame in looked_at):
            labels, spacing = metrics.nearest(scene.pixels, points), np.nan
            if scene.curve is not None:
                order = np.argsort(nearest_on(scene.curve, points)[0], kind="stable")
                spacing = metrics.spacing_cv(points[order], task.configuration.layout)
            silhouette = metrics.silhouette(scene.pixels, labels, sample=_SAMPLED)
            quality.append((silhouette, metrics.calinski_harabasz(scene.pixels, labels), 100 * spacing))
        sc, ch, spacing = np.mean(quality, axis=0).tolist()
        ours = ours or ch
        row = Row(work=name, method=method, frames=len(turns)) | {"median [ms]": (ms := median_ms(turns))}
        over, over_cold = (ms / median_ms(found[each]) for each in (WARM, COLD))
        row |= {"over ours": over, "over cold": over_cold, "SC": sc, "CH": ch, "CH over ours": ch / ours}
        yield Row(row, **{"spacing CV [%]": spacing if spacing == spacing else None})


def stray_frames(scene: tuple[tuple[int, int], str, int]) -> Iterator[Row]:
    """Detect a pattern without a track, in a mask, with noisy depth under it, or in an image of the same pixels.

    Yields:
        The least processor time of a frame in up to three tries.
    """
    size, pattern, seed = scene
    rng, (width, height) = np.random.default_rng([seed, list(PATTERNS).index(pattern)]), size
    mask = PATTERNS[pattern](rng, size)
    depth = (0.7 + 0.002 * rng.standard_normal(mask.shape)).astype(np.float32)
    camera = Intrinsics(width, height, float(width), float(width), width / 2 - 0.5, height / 2 - 0.5)
    rgb = np.repeat(mask[..., None], 3, axis=2)
    given: dict[str, Callable[[ShapeDetector], Detection]] = {
        "mask": lambda detector: detector.detect_mask(mask),
        "mask and depth": lambda detector: detector.detect_mask(mask, depth, camera),
        "image": lambda detector: detector.detect(rgb, depth, camera),
        "cloud": lambda detector: detector.detect_mask(mask, depth, camera),
    }
    for kind, (name, look) in product((Centerline, Contour, Surface), given.items()):
        spec = kind(lift="cloud" if name == "cloud" else "points")
        detector, taken = ShapeDetector([spec], GrayRange(low=128)), list[tuple[Detection, float]]()
        while len(taken) < _REPEATS and not (taken and taken[0][1] > _ENOUGH):
            detector.reset()
            taken.append(timed(partial(look, detector), time.process_time))
        found, ms = min(taken, key=lambda each: each[1])
        yield Row(size=f"{width}x{height}", pattern=pattern, shape=spec.kind, given=name, ms=ms, refused=not found.ok)


CLAIMS: Final = (
    Claim(
        "speed.peers", "Time and quality of the detector and of other methods on the same masks, by turns.",
        lambda effort: product(("rope", "contour", "cloth"), [max(effort.count(100), 10)], [effort.seed]), peers,
        limits=(
            *(Limit("CH over ours", at_most=1 / least, where={"work": name, "method": "K-means, n_init 10"})
              for name, least in (("rope", 0.995), ("contour", 0.995), ("cloth", 0.96))),
            Limit("CH over ours", at_most=1, where={"work": ("rope", "contour"), "method": "Gaussian mixture"}),
            Limit("spacing CV [%]", at_most=1, unit="%", where={"work": ("rope", "contour"), "method": WARM}),
            # Half of what is seen, so that a loss of speed by half is noticed.
            Limit("over ours", at_least=10, unit="x", where={"work": "rope", "method": "K-means, n_init 1"}),
            Limit("over ours", at_least=100, unit="x", where={"work": "cloth", "method": "K-means, n_init 1"}),
        ),
        alone=True, needs=("minisom", "skimage"),
    ),
    Claim(
        "speed.patterns", "Processor time of a frame that shows no object, without a track, over patterns.",
        lambda effort: product(SIZES, list(PATTERNS)[:: max(round(1 / effort.share), 1)], [effort.seed]), stray_frames,
        ("size", "shape", "given"),
        {"patterns": len, "refused": total("refused"), "worst [ms]": of(worst, "ms"),
         "slowest": lambda rows: max(rows, key=lambda row: row.ms).pattern},
        limits=(
            Limit("worst [ms]", at_most=25, unit="ms", where={"size": "640x480"}, known="44 ms on a slow processor"),
            Limit("worst [ms]", at_most=75, unit="ms", where={"size": "1280x720"}),
        ),
        alone=True,
    ),
)  # fmt: skip
