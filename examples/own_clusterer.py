"""Write a clusterer that divides the pixels into equal groups along their main direction.

The program compares it with the self-organising map. The clusterer returns centres in any order;
they are then sorted along the form that the map has fitted.

Run: ``uv run examples/own_clusterer.py``
"""

from dataclasses import dataclass

import cv2
import numpy as np

from shape_obs import Centerline, HSVRange, ShapeDetector
from shape_obs.clustering import Centres, Clusterer
from shape_obs.geometry.observed import Samples
from shape_obs.geometry.topology import Topology

BLUE = HSVRange(low=(95, 100, 60), high=(125, 255, 255))


@dataclass(frozen=True)
class Quantiles(Clusterer, kind="quantiles"):
    """Sort the samples along their main direction, and return the means of N equal groups.

    Args:
        trim: Share of each group that is left out at either side, 0 ... 0.4.
    """

    trim: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.trim <= 0.4:
            raise ValueError(f"quantiles: trim must lie in 0 ... 0.4, got {self.trim}.")

    def centres(self, samples: Samples, layout: Topology, seed: int) -> Centres:
        """Return N centres, of shape (N, D), from (M, D) samples."""
        points = samples.points
        main = np.linalg.eigh(np.cov(points.T))[1][:, -1]
        groups = np.array_split(points[np.argsort(points @ main)], layout.size)
        means = []
        for group in groups:
            out = int(self.trim * len(group))
            means.append(group[out : len(group) - out].mean(axis=0))
        return Centres(np.array(means), steps=1, settled=True)


def photo() -> tuple[np.ndarray, np.ndarray]:
    """Return an image of a blue rope on a light table, and the rope's true centerline."""
    s = np.linspace(0, 1, 400)
    rope = np.stack([80 + 480 * s, 240 + 60 * np.sin(6 * s)], axis=1)
    image = np.full((480, 640, 3), (200, 198, 190), np.uint8)
    line = np.round(rope).astype(np.int32)
    cv2.polylines(image, [line], False, (20, 70, 160), 13, cv2.LINE_AA)
    return image, rope


def main() -> None:
    image, truth = photo()
    for clustering in ("som", "quantiles", Quantiles(trim=0.2)):
        detector = ShapeDetector([Centerline(n=12)], BLUE, clustering=clustering)
        rope = detector.detect(image).shapes[0]
        away = np.linalg.norm(rope.pixels[:, None] - truth[None], axis=2).min(axis=1)
        gaps = np.linalg.norm(np.diff(rope.pixels, axis=0), axis=1)
        name = clustering if isinstance(clustering, str) else f"quantiles, {clustering.trim}"
        print(f"{name:<20} ok: {rope.ok}, off by at most {away.max():.1f} px,", end=" ")
        print(f"gaps {gaps.min():.0f} ... {gaps.max():.0f}")


if __name__ == "__main__":
    main()
