"""A cloud's points gathered into cubes, and how the cubes are connected."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from shape_obs.geometry.observed import Samples

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

_EDGE: Final = 0.5  # of a voxel, in widths
_COARSE: Final = 1 / 40  # and at most, of the extent: what is no rope is not thin
_MIN_SHARE: Final = 0.02  # of the largest piece's points; smaller pieces are specks
_PER_VOXEL: Final = 2.0  # points; with fewer the voxels would be the points, and fall apart
_GROWTH: Final = 1.5
_LINK: Final = 2.0  # edges: diagonal neighbours are linked, and across a voxel that happens to be empty
# Of the cloud's extent: voxels are neither finer nor coarser.
_FINEST: Final = 1e-3
_COARSEST: Final = 1 / 8


def gather(points: Array, edge: float) -> tuple[Samples, Indices]:
    """Gather points into cubes of about ``edge``, larger where the points lie farther apart.

    Args:
        points: ``(M, 3)`` metres, M > 0.
        edge: Metres.

    Returns:
        Centroid and count of each cube that holds points; ``(M,)`` which cube each point lies in.
    """
    low = points.min(axis=0)
    extent = float(np.linalg.norm(points.max(axis=0) - low))
    edge = max(edge, _FINEST * extent, 1e-9)
    while True:
        cell = ((points - low) / edge).astype(np.int64)
        key = np.ravel_multi_index(tuple(cell.T), tuple(cell.max(axis=0) + 1))
        _, cube, weight = np.unique(key, return_inverse=True, return_counts=True)
        if len(points) >= _PER_VOXEL * len(weight) or edge >= _COARSEST * extent:
            break
        edge *= _GROWTH
    sums = np.stack([np.bincount(cube, weights=points[:, d] - low[d]) for d in range(3)], axis=1)
    return Samples(sums / weight[:, None] + low, weight.astype(np.float64), edge), cube


def links(samples: Samples) -> csr_matrix:
    """Return ``(M, M)`` distances between connected samples, metres, each pair once."""
    tree = KDTree(samples.points, balanced_tree=False, compact_nodes=False)  # a third faster to build
    pairs = tree.query_pairs(_LINK * samples.scale, output_type="ndarray")
    step = samples.points[pairs[:, 0]] - samples.points[pairs[:, 1]]
    length = np.maximum(np.sqrt(np.einsum("pd,pd->p", step, step)), 1e-12)  # csgraph reads 0 as no link
    return csr_matrix((length, (pairs[:, 0], pairs[:, 1])), shape=(len(samples), len(samples)))


class Piece(NamedTuple):
    """One connected piece.

    Args:
        samples: Indices of the cloud's samples.
        area: Points.
    """

    samples: Indices
    area: float


class ConnectedVoxels(NamedTuple):
    """The pieces of a cloud without specks.

    Args:
        points: ``(M', 3)`` metres.
        sample: ``(M',)`` which sample each point belongs to.
        samples: Their voxels.
        links: How the voxels are connected.
        components: Largest first.
    """

    points: Array
    sample: Indices
    samples: Samples
    links: csr_matrix
    components: tuple[Piece, ...]


def connect(points: Array, width: float) -> ConnectedVoxels:
    """Gather points into voxels, find the connected pieces and leave out specks.

    Args:
        points: ``(M, 3)`` in metres.
        width: Of the object as a rope, metres; 0 if unknown.
    """
    if not len(points):
        nothing = Samples(np.zeros((0, 3)), np.zeros(0), 1.0)
        return ConnectedVoxels(points, np.zeros(0, np.intp), nothing, csr_matrix((0, 0)), ())
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    samples, cube = gather(points, min(_EDGE * width, _COARSE * extent))
    graph = links(samples)
    count, label = connected_components(graph, directed=False)
    mass = np.bincount(label, weights=samples.weight, minlength=count)
    pieces = [k for k in np.argsort(-mass, kind="stable") if mass[k] >= _MIN_SHARE * mass.max()]
    if len(pieces) < count:
        keep = np.flatnonzero(np.isin(label, pieces))
        place = np.full(len(samples), -1)
        place[keep] = np.arange(len(keep))
        cube, label = place[cube], label[keep]
        points, cube = points[cube >= 0], cube[cube >= 0]
        samples = Samples(samples.points[keep], samples.weight[keep], samples.scale)
        graph = graph[keep][:, keep]
    components = tuple(Piece(np.flatnonzero(label == k), float(mass[k])) for k in pieces)
    return ConnectedVoxels(points, cube, samples, graph, components)
