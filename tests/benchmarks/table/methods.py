"""The methods of the table, and the measures of each one on a frame."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from shape_obs.bench.scenes import Sheet
from shape_obs.clustering.base import Centres, Clusterer
from shape_obs.clustering.fcm import FuzzyCMeans
from shape_obs.clustering.gmm import GaussianMixture
from shape_obs.clustering.kmeans import KMeans
from shape_obs.clustering.kohonen import Kohonen
from shape_obs.configurations.base import Configuration
from shape_obs.configurations.surface import Surface
from shape_obs.detector import ShapeDetector
from shape_obs.geometry.observed import Samples
from shape_obs.geometry.topology import Ring, Topology
from shape_obs.image.find_region import find_region
from shape_obs.image.roi import Whole
from shape_obs.image.segmentation import Segmentation
from shape_obs.metrics import calinski_harabasz, nearest, silhouette, spacing_cv
from tests.benchmarks import Clock
from tests.benchmarks.interleaved_timing import CLOCKS, timed
from tests.benchmarks.scores import SLIP, outline_score, score
from tests.benchmarks.sheets import score_sheet
from tests.benchmarks.table.frames import CONFIGURATIONS, Name, Scene
from tests.benchmarks.tables import Row

Array = npt.NDArray[np.float64]
Method = Literal["gmm", "fcm", "kmeans", "kohonen", "som"]

# In the paper's order, each with the default settings of its spec; None is the detector with its defaults.
METHODS: Final[dict[Method, Clusterer | None]] = {
    "gmm": GaussianMixture(),
    "fcm": FuzzyCMeans(),
    "kmeans": KMeans(),
    "kohonen": Kohonen(),
    "som": None,
}
SAMPLED: Final = 2000  # pixels that the silhouette counts where it does not count all
# The measures of a frame on which the shape was not found.
_REFUSED: Final = Row(
    dict.fromkeys(("ok", "ordered", "own_order", "settled"), False),
    **dict.fromkeys(("pixels", "steps"), 0),
    **dict.fromkeys(("sc", "ch", "ms", "cv"), np.nan),
)


@dataclass(frozen=True)
class _Watched(Clusterer):
    """A clusterer that stores its last result and its time.

    Args:
        inner: The clusterer.
        seen: Where the result and the time are stored.
        now: Returns seconds.
    """

    inner: Any
    seen: Any
    now: Any

    def centres(self, samples: Samples, layout: Topology, seed: int) -> Centres:
        """Return the centres of the clusterer."""
        self.seen["centres"], self.seen["ms"] = timed(lambda: self.inner.centres(samples, layout, seed), self.now)
        return self.seen["centres"]


class Runner:
    """Run one method frame by frame: ours tracks; a clusterer starts cold, and its centres are sorted along our curve.

    Args:
        name: Name of the configuration.
        method: Name of the method.
        clock: The clock.
    """

    def __init__(self, name: Name, method: Method, clock: Clock = "wall") -> None:
        self._spec, self._seen, self._now = CONFIGURATIONS[name], dict[str, Any](), CLOCKS[clock]
        clusterer = METHODS[method]
        options: Any = {} if clusterer is None else {"clustering": _Watched(clusterer, self._seen, self._now)}
        self._detector = ShapeDetector([self._spec], **options)

    def points(self, scene: Scene) -> Array | None:
        """Return the ordered points on a frame, ``(N, 2)``, or None if the shape was not found."""
        return self._found(scene)[0]

    def measure(self, scene: Scene, frame: int, exact: bool) -> tuple[Array | None, Row]:
        """Return the points, and their measures if the shape was found.

        Args:
            scene: The frame.
            frame: Number of the frame.
            exact: Whether the silhouette counts all pixels, not ``SAMPLED`` of them.

        Returns:
            The points, and a row: ``pixels``: M, the number of clustered pixels; ``ok``: whether the shape was found;
            ``sc``: silhouette; ``ch``: Calinski-Harabasz over all pixels; ``ms``: of a clusterer from the pixels to its
            centres, of ours from the mask to the ordered points; ``cv``: standard deviation over mean of the gaps;
            ``ordered``: whether the points follow each other along the known curve, on a surface whether each is within
            half a cell of its position on the material; ``own_order``: the same for the order that the method itself
            returns; ``steps`` of a clusterer, and whether it ``settled``.
        """
        points, ms, centres = self._found(scene)
        if points is None:
            return None, Row(_REFUSED, frame=frame, exact=exact)
        pixels = clustered_pixels(self._spec, scene)
        labels = nearest(pixels, points)
        ordered = in_order(self._spec, points, scene)
        return points, Row(
            frame=frame,
            pixels=len(pixels),
            ok=True,
            sc=silhouette(pixels, labels, sample=None if exact else SAMPLED, seed=frame),
            exact=exact,
            ch=calinski_harabasz(pixels, labels),
            ms=ms,
            cv=spacing_cv(points, self._spec.layout),
            ordered=ordered,
            own_order=ordered if centres is None else in_order(self._spec, centres.places, scene),
            steps=0 if centres is None else centres.steps,
            settled=centres is None or centres.settled,
        )

    def _found(self, scene: Scene) -> tuple[Array | None, float, Centres | None]:
        found, ms = timed(lambda: self._detector.detect_mask(scene.mask, anchors=scene.anchors), self._now)
        shape = found.shapes[0]
        if shape.reason:
            return None, np.nan, None
        return shape.pixels.astype(np.float64), self._seen.get("ms", ms), self._seen.get("centres")


def measured(
    name: Name, method: Method, chunk: Iterable[tuple[int, Scene]], exact: npt.NDArray[np.int_], clock: Clock = "wall"
) -> Iterator[Row]:
    """Measure a method on the numbered frames of one chunk; the silhouette is exact on the frames in ``exact``."""
    runner = Runner(name, method, clock)
    for frame, scene in chunk:
        yield runner.measure(scene, frame, bool(np.isin(frame, exact)))[1]


def clustered_pixels(spec: Configuration, scene: Scene) -> Array:
    """Return the pixels that are clustered, ``(M, 2)``: those of the mask, or of a contour's outline."""
    height, width = scene.mask.shape
    region = find_region(scene.mask, Whole().window((height, width)), Segmentation.min_area, Segmentation.min_share)
    return spec.clusterer_samples(region).points


def in_order(spec: Configuration, points: Array, scene: Scene) -> bool:
    """Return whether points are in the right order, from any start and in either direction."""
    if isinstance(scene.truth, Sheet):
        assert isinstance(spec, Surface)
        found = [score_sheet(points, scene.truth, spec.rows, spec.cols, "centers", quarters) for quarters in range(4)]
        return min(result.slip for result in found) <= SLIP
    if isinstance(spec.layout, Ring):
        return any(outline_score(way, scene.truth).ordered for way in (points, points[::-1]))
    return score(points, scene.truth, "centers", directed=False).ordered
