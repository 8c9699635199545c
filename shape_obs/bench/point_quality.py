"""How well N points in any order stand for a mask: silhouette, Calinski-Harabasz and how evenly they are spread."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from shape_obs import metrics
from shape_obs.bench.workloads import Scene
from shape_obs.geometry.polyline import nearest_on
from shape_obs.geometry.topology import Topology

Array = npt.NDArray[np.float64]

EXACT: Final = 10_000  # pixels up to which every one's silhouette is computed
SAMPLED: Final = 2_000  # else that of so many, each against all pixels


class Quality(NamedTuple):
    """Of N points on one frame.

    Args:
        silhouette: -1...1, the mean over all pixels, beyond ``EXACT`` of them over ``SAMPLED``, each against all.
        calinski_harabasz: Over all pixels.
        spacing: Standard deviation of the gaps over their mean: between successive points along the known line; on a
            cloth the distance from each point to the nearest other.
    """

    silhouette: float
    calinski_harabasz: float
    spacing: float


def point_quality(scene: Scene, points: Array, layout: Topology) -> Quality:
    """The quality of one method's points; a pixel belongs to the nearest of them.

    Args:
        scene: The frame; its pixels are what is to be represented.
        points: (N,2) in any order.
        layout: How they would hang together, were they in order.
    """
    pixels, labels = scene.pixels, metrics.nearest(scene.pixels, points)
    return Quality(
        metrics.silhouette(pixels, labels, sample=None if len(pixels) <= EXACT else SAMPLED),
        metrics.calinski_harabasz(pixels, labels),
        _spacing(scene, points, layout),
    )


def _spacing(scene: Scene, points: Array, layout: Topology) -> float:
    """The coefficient of variation of the gaps, see ``Quality``."""
    if scene.curve is None:
        gaps = np.asarray(KDTree(points).query(points, k=2)[0])[:, 1]
        return float(gaps.std() / gaps.mean())
    place, _ = nearest_on(scene.curve, points)
    return metrics.spacing_cv(points[np.argsort(place, kind="stable")], layout)
