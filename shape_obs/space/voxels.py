"""Voxels: a cloud's points gathered into cubes, and how the cubes hang together."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from shape_obs.samples import Samples

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

_PER_VOXEL: Final = 2.0  # points; with fewer the voxels would be the points, and fall apart
_GROWTH: Final = 1.5
_LINK: Final = 2.0  # edges: diagonal neighbours are linked, and across a voxel that happens to be empty
# Of the cloud's extent: voxels are neither finer nor coarser.
_FINEST: Final = 1e-3
_COARSEST: Final = 1 / 8


class Voxels(NamedTuple):
    """Points in cubes.

    Args:
        samples: Centroid and count of each cube that holds points; M' of them.
        cube: (M,) which cube each point lies in.
    """

    samples: Samples
    cube: Indices


def gather(points: Array, edge: float) -> Voxels:
    """Gather points into cubes of about ``edge``, larger where the points lie farther apart.

    Args:
        points: (M,3) metres, M > 0.
        edge: Metres.
    """
    low = points.min(axis=0)
    extent = float(np.linalg.norm(points.max(axis=0) - low))
    edge = max(edge, _FINEST * extent, 1e-9)
    while True:
        cube, count = _cubes(points - low, edge)
        if len(points) >= _PER_VOXEL * len(count) or edge >= _COARSEST * extent:
            break
        edge *= _GROWTH
    weight = count.astype(np.float64)
    sums = np.stack([np.bincount(cube, weights=points[:, d] - low[d]) for d in range(3)], axis=1)
    return Voxels(Samples(sums / weight[:, None] + low, weight, edge), cube)


def links(samples: Samples) -> csr_matrix:
    """(M,M) distances between samples that hang together, metres, each pair once."""
    tree = KDTree(samples.points, balanced_tree=False, compact_nodes=False)  # a third faster to build
    pairs = tree.query_pairs(_LINK * samples.scale, output_type="ndarray")
    step = samples.points[pairs[:, 0]] - samples.points[pairs[:, 1]]
    length = np.maximum(np.sqrt(np.einsum("pd,pd->p", step, step)), 1e-12)  # csgraph reads 0 as no link
    return csr_matrix((length, (pairs[:, 0], pairs[:, 1])), shape=(len(samples), len(samples)))


def pieces(graph: csr_matrix, weight: Array, min_share: float) -> tuple[Indices, ...]:
    """The connected pieces of at least ``min_share`` of the largest's weight, largest first: sample indices of each."""
    count, label = connected_components(graph, directed=False)
    mass = np.bincount(label, weights=weight, minlength=count)
    kept = np.argsort(-mass, kind="stable")
    kept = kept[mass[kept] >= min_share * mass.max(initial=0.0)]
    return tuple(np.flatnonzero(label == piece) for piece in kept)


def _cubes(offset: Array, edge: float) -> tuple[Indices, Indices]:
    """Which cube each point lies in, numbered without gaps, and how many points each cube holds."""
    cell = (offset / edge).astype(np.int64)
    size = cell.max(axis=0) + 1
    key = (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]
    _, cube, count = np.unique(key, return_inverse=True, return_counts=True)
    return cube.reshape(-1), count
