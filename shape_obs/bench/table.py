"""Reproduce the paper's Table I: silhouette, Calinski-Harabasz score and time of clusterers on simulated frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from scipy.spatial import KDTree
from scipy.stats import sem
from scipy.stats import t as student

from shape_obs.bench.photos import BLUE, photographed
from shape_obs.bench.report import CLOCKS, markdown_table
from shape_obs.bench.scenes import Array, Mask, Rope, Sheet, border_of, draw_sheet, moving_rope, moving_sheet
from shape_obs.clustering.base import Centres, Clusterer, Clustering
from shape_obs.configurations.base import Configuration
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.observed import Samples
from shape_obs.geometry.polyline import nearest_on
from shape_obs.geometry.topology import Topology
from shape_obs.image.find_region import find_region
from shape_obs.image.roi import Whole
from shape_obs.image.segmentation import Segmentation
from shape_obs.metrics import calinski_harabasz, in_order, nearest, silhouette, spacing_cv
from shape_obs.utils.threads import one_thread

Row = dict[str, Any]

CONFIGURATIONS: Final[dict[str, Configuration]] = {
    "centerline": Configuration.from_dict({"kind": "centerline", "n": 20, "ends": "centers"}),
    "contour": Configuration.from_dict({"kind": "contour", "n": 32}),
    # The anchor makes the rows run along the cloth's long side; otherwise the cells of some cloths would be slivers.
    "surface": Configuration.from_dict(
        {"kind": "surface", "rows": 4, "cols": 8, "ends": "centers", "anchor": "corner"}
    ),
}
LABELS: Final = {"gmm": "GMM", "fcm": "FCM", "kmeans": "KMA", "kohonen": "SOM (paper's)", "som": "ours"}
PAPER: Final = {  # its Table I: silhouette, Calinski-Harabasz score, milliseconds
    "gmm": {"sc": 0.342, "ch": 47593, "ms": 208},
    "fcm": {"sc": 0.268, "ch": 39072, "ms": 187},
    "kmeans": {"sc": 0.254, "ch": 34874, "ms": 126},
    "kohonen": {"sc": 0.279, "ch": 42081, "ms": 63},
}
MEASURES: Final = {"sc": ("SC", 1.0, 3), "ch": ("CH", 1.0, 0), "ms": ("time [s]", 1e-3, 4)}  # title, factor, digits
_SAMPLED: Final = 2000  # pixels that the silhouette counts, each against all pixels


class Picture(NamedTuple):
    """One frame.

    Args:
        mask: The segmented object, ``(H, W)`` uint8, 0 or 255.
        truth: The known axis, or the known outline with its first point again, ``(P, 2)`` pixels; or the known cloth.
    """

    mask: Mask
    truth: Array | Sheet


def episodes(frames: int) -> list[range]:
    """Return the numbers of the frames of each episode; there are about 20 episodes, of 5 to 50 frames."""
    length = int(np.clip(frames // 20, 5, 50))
    return [range(first, min(first + length, frames)) for first in range(0, frames, length)]


def pictures(name: str, episode: int, count: int, seed: int) -> Iterator[Picture]:
    """Photograph an episode of ``count`` frames: a rope, or a cloth, that wanders, turns and bends.

    The cloth's size gives some 20,000 pixels, and its aspect makes the cells of 4 x 8 about square.
    """
    rng = np.random.default_rng([seed, list(CONFIGURATIONS).index(name), episode])
    large = moving_sheet(rng, 6.0 / 0.84, count, aspect=2.0)
    cloths = (draw_sheet((320, 240) + 0.84 * (sheet.points - (320, 240))) for sheet in large)
    for thing in moving_rope(rng, 6.0, count) if name == "centerline" else cloths:
        photo = cv2.GaussianBlur(photographed(rng, thing.mask, contrast=1.5, noise=6.0), (0, 0), 0.7)
        mask = cv2.inRange(cv2.cvtColor(photo, cv2.COLOR_RGB2HSV), np.array(BLUE.low), np.array(BLUE.high))
        truth = thing.curve if isinstance(thing, Rope) else thing
        if isinstance(truth, Sheet) and name == "contour":
            truth = border_of(truth.points)
            truth = np.concatenate([truth, truth[:1]])
        yield Picture(np.asarray(mask, dtype=np.uint8), truth)


@dataclass(frozen=True)
class _Timed(Clusterer):
    """A clusterer that appends its times to ``milliseconds``."""

    inner: Any
    now: Any
    milliseconds: Any

    def centres(self, samples: Samples, layout: Topology, seed: int) -> Centres:
        """Return the centres of the inner clusterer."""
        begin = self.now()
        found = self.inner.centres(samples, layout, seed)
        self.milliseconds.append(1e3 * (self.now() - begin))
        return found


def run(name: str, method: str, frames: Sequence[Picture], clock: str = "wall") -> Iterator[Row]:
    """Run one method through an episode: ours tracks; a clusterer starts cold, and our form sorts its centres.

    Yields:
        Whether the shape is ``ok``, and if it is: number of ``pixels``; silhouette ``sc``; Calinski-Harabasz score
        ``ch``; ``ms``: of a clusterer from the pixels to its centres, of ours from the mask to the ordered points;
        ``cv``: standard deviation over mean of the gaps; ``ordered``, see ``in_right_order``.
    """
    spec, now, times = CONFIGURATIONS[name], CLOCKS[clock], list[float]()
    clusterer = Clustering.from_dict({"kind": method})
    if isinstance(clusterer, Clusterer):
        clusterer = _Timed(clusterer, now, times)
    detector = ShapeDetector([spec], clustering=clusterer)
    for mask, truth in frames:
        anchors = {"corner": tuple(truth.points[0, 0].tolist())} if isinstance(truth, Sheet) else {}
        begin = now()
        shape = detector.detect_mask(mask, anchors=anchors).shapes[0]
        ms = times[-1] if times else 1e3 * (now() - begin)
        if shape.reason:
            yield {"ok": False}
            continue
        points, pixels = shape.pixels.astype(np.float64), clustered_pixels(spec, mask)
        labels = nearest(pixels, points)
        sc, ch = silhouette(pixels, labels, sample=_SAMPLED), calinski_harabasz(pixels, labels)
        cv, ordered = spacing_cv(points, spec.layout), in_right_order(points, truth)
        yield {"ok": True, "pixels": len(pixels), "sc": sc, "ch": ch, "ms": ms, "cv": cv, "ordered": ordered}


def clustered_pixels(spec: Configuration, mask: Mask) -> Array:
    """Return the pixels that are clustered, ``(M, 2)``: those of the mask, or of a contour's outline."""
    window = Whole().window((mask.shape[0], mask.shape[1]))
    return spec.clusterer_samples(find_region(mask, window, Segmentation.min_area, Segmentation.min_share)).points


def in_right_order(points: Array, truth: Array | Sheet) -> bool:
    """Return whether points follow each other along the known curve, from any start and in either direction.

    On a cloth each of 4 x 8 points must be within half a cell of its place.
    """
    if isinstance(truth, Sheet):
        row, col = np.divmod(np.arange(32), 8)
        places = np.stack([8 + 16 * row, 4 + 8 * col], axis=1)  # in the lattice of 65 x 65 points
        turned = (np.rot90(truth.points, quarters).reshape(-1, 2) for quarters in range(4))
        found = (np.stack(np.divmod(KDTree(lattice).query(points)[1], 65), axis=1) for lattice in turned)
        return any(np.all(np.abs(each - places) <= (8, 4)) for each in found)
    arc, closed = nearest_on(truth, points)[0], np.array_equal(truth[0], truth[-1])
    length = float(np.linalg.norm(np.diff(truth, axis=0), axis=1).sum())
    return any(in_order(way, length if closed else None) for way in (arc, arc[::-1]))


def measure(
    names: Sequence[str], methods: Sequence[str], frames: int, seed: int, clock: str, tick: Callable[[], Any]
) -> list[Row]:
    """Run methods on all frames of configurations, on one thread.

    Returns:
        A row for each frame and method: ``configuration``, ``method``, ``episode``, and the measures of ``run``.
    """
    import sklearn.cluster
    import sklearn.mixture  # noqa: F401  # loaded before the threads are limited

    rows = []
    with one_thread():
        for (episode, numbers), name in product(enumerate(episodes(frames)), names):
            drawn = list(pictures(name, episode, len(numbers), seed))
            for method in methods:
                if episode == 0:
                    list(run(name, method, drawn[:1]))  # loads and compiles what runs for the first time
                key = {"configuration": name, "method": method, "episode": episode}
                rows += [key | row for row in run(name, method, drawn, clock)]
            tick()
    return rows


def summarised(rows: Sequence[Row]) -> list[Row]:
    """Return a row for each configuration and method, and for ``"all"`` configurations if all were measured.

    Returns:
        Number of ``frames``, and of those ``refused``, which the other values leave out; means of ``pixels``, ``cv``,
        ``ordered``, and of each measure with half its 95 % interval, such as ``sc_half``, for which an episode counts
        as one value; NaN is unknown.
    """
    found = []
    names, methods = (list(dict.fromkeys(row[key] for row in rows)) for key in ("configuration", "method"))
    for name, method in product(names, methods):
        some = [row for row in rows if (row["configuration"], row["method"]) == (name, method)]
        good = [row for row in some if row["ok"]]
        result = {"configuration": name, "method": method, "frames": len(some), "refused": len(some) - len(good)}
        for key in ("pixels", "cv", "ordered", *MEASURES):
            result[key] = float(np.mean([row[key] for row in good])) if good else math.nan
        for key in MEASURES:
            parts = {row["episode"]: [r[key] for r in good if r["episode"] == row["episode"]] for row in good}
            means = [np.mean(part) for part in parts.values()]
            enough = len(means) > 1
            result[f"{key}_half"] = float(student.ppf(0.975, len(means) - 1) * sem(means)) if enough else math.nan
        found.append(result)
    for method in methods if len(names) == len(CONFIGURATIONS) else ():
        of = [row for row in found if row["method"] == method]
        result = {"configuration": "all", "method": method, **{k: sum(r[k] for r in of) for k in ("frames", "refused")}}
        result |= {key: float(np.mean([row[key] for row in of])) for key in ("pixels", "cv", "ordered", *MEASURES)}
        # The configurations are independent, so the squares of their intervals add up.
        found.append(result | {f"{k}_half": math.hypot(*(r[f"{k}_half"] for r in of)) / len(of) for k in MEASURES})
    return found


def markdown(found: Sequence[Row]) -> str:
    """Return the summary as Markdown: a table for each configuration, and for all of them with those of the paper."""
    blocks = []
    for name in dict.fromkeys(row["configuration"] for row in found):
        rows = []
        for result in (result for result in found if result["configuration"] == name):
            row = {"": LABELS[result["method"]]}
            for key, (title, factor, digits) in MEASURES.items():
                row[title] = f"{result[key] * factor:.{digits}f} ± {result[f'{key}_half'] * factor:.{digits}f}"
                if name == "all":
                    published = PAPER.get(result["method"], {}).get(key)
                    row[f"{title}, paper"] = "–" if published is None else f"{published * factor:g}"
            row |= {"gap CV": f"{100 * result['cv']:.1f} %", "order right": f"{100 * result['ordered']:.1f} %"}
            rows.append(row | {"refused": str(result["refused"]), "M": f"{result['pixels']:.0f}"})
        blocks.append(f"## {name.capitalize()}\n\n{markdown_table(rows)}")
    of = {row["method"]: row for row in found if row["configuration"] == "all" and row["method"] in PAPER}
    for key, (title, _, _) in MEASURES.items() if len(of) == len(PAPER) else ():
        orders = [sorted(PAPER, key=lambda m, v=values: v[m][key], reverse=key != "ms") for values in (PAPER, of)]
        paper, here = (" > ".join(LABELS[method] for method in order) for order in orders)
        blocks.append(f"{title}, best first. In the paper: {paper}. Here: {here}.")
    return "\n\n".join(blocks) + "\n"
