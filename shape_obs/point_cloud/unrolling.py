"""Unrolling: a bent sheet's points in a plane, distances along the sheet kept, and the sheet's border there.

The border lies where the density of the points has fallen to half.

References:
    J. B. Tenenbaum, V. de Silva, J. C. Langford, "A Global Geometric Framework for Nonlinear Dimensionality
    Reduction", Science 290, 2000 (Isomap); V. de Silva, J. B. Tenenbaum, "Sparse Multidimensional Scaling using
    Landmark Points", 2004.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import KDTree

from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.observed import Samples
from shape_obs.geometry.outline import clockwise

Array = npt.NDArray[np.float64]

# A sheet whose rms height over its plane is below this share of its rms half breadth is projected: it loses 0.6 %.
_FLAT: Final = 0.05
_LANDMARKS: Final = 24
_RIDGE: Final = 0.03  # of a neighbourhood's spread: across the sheet there is only noise to fit
_BLENDED: Final = 4
_BRIDGE: Final = 1.3  # shortest gaps: pieces are linked where they lie nearly as close as anywhere
_PIXELS: Final = 150  # along the map's longer side
_UNDER_BLUR: Final = 20.0  # points that the blur averages over, so that chance makes no border
_MIN_BLUR: Final = 1.2  # pixels
_WIDER: Final = 3.0  # blurs: over which the density may change
_FINER: Final = 3  # the border is drawn on pixels so many times finer
_POINTS: Final = 300
_SMOOTH: Final = 2.0  # points


@dataclass(frozen=True, eq=False)
class Chart:
    """A plane map of a sheet: ``flat`` is not mirrored as seen along +z, and turned as (x, y).

    Args:
        samples: Of the sheet, metres.
        links: Distances of those that are connected, each pair once.
        flat: ``(M, 2)`` metres, where the samples lie on the map.
    """

    samples: Samples
    links: csr_matrix
    flat: Array

    def to_flat(self, points: Array, sample: npt.NDArray[np.intp]) -> Array:
        """Return ``(P, 3)`` points on the map, each by the neighbourhood of its sample: ``(P, 2)``."""
        offset = points - self.samples.points[sample]
        return self.flat[sample] + np.einsum("pi,pij->pj", offset, self._jacobians[0][sample])

    def to_space(self, flat: Array) -> Array:
        """Return ``(P, 2)`` places on the map as points of the sheet: ``(P, 3)`` metres."""
        tree: Any = KDTree(self.flat)
        distance, nearest = tree.query(flat, k=np.arange(min(_BLENDED, len(self.flat))) + 1)
        offset = flat[:, None] - self.flat[nearest]
        points = self.samples.points[nearest] + np.einsum("pki,pkij->pkj", offset, self._jacobians[1][nearest])
        weight = 1 / (distance + 0.1 * self.samples.scale) ** 2
        return np.einsum("pk,pkd->pd", weight, points) / weight.sum(axis=1, keepdims=True)

    @cached_property
    def _jacobians(self) -> tuple[Array, Array]:
        """The Jacobians of the map at each sample ``(M, 3, 2)`` and of its inverse ``(M, 2, 3)``, by least squares."""
        links: Any = (self.links + self.links.T).tocoo()
        step = self.samples.points[links.col] - self.samples.points[links.row]
        flat = self.flat[links.col] - self.flat[links.row]
        return _regression(links.row, step, flat, len(self.flat)), _regression(links.row, flat, step, len(self.flat))


def chart(samples: Samples, links: csr_matrix) -> Chart:
    """Unroll a sheet: onto its principal plane if it is flat, else by Isomap.

    Args:
        samples: M >= 3 of them.
        links: Distances of those that are connected, each pair once.
    """
    middle = np.average(samples.points, axis=0, weights=samples.weight)
    offset = samples.points - middle
    values, axes = np.linalg.eigh((samples.weight[:, None] * offset).T @ offset)
    if values[0] <= _FLAT**2 * values[1]:
        flat = offset @ axes[:, 1:]
    else:
        links = _joined(samples, links)
        flat = _isomap(links, len(samples))
        near: Any = links.tocoo()
        step = np.linalg.norm(flat[near.row] - flat[near.col], axis=1)
        # Paths over links zigzag, which makes all distances too long by the same few percent.
        flat *= float(step @ near.data) / max(float(step @ step), 1e-18)
    u, _, v = np.linalg.svd(flat.T @ offset[:, :2])  # turned as (x, y), and mirrored where that lies nearer
    return Chart(samples, links, flat @ (u @ v))


def _isomap(links: csr_matrix, size: int) -> Array:
    """Return the landmark Isomap: ``(M, 2)`` from the distances over the links to a few samples."""
    landmarks = np.random.default_rng(0).choice(size, min(_LANDMARKS, size), replace=False)
    square = np.asarray(dijkstra(links, directed=False, indices=landmarks)) ** 2
    own = square[:, landmarks]
    mean = own.mean(axis=0)
    centred = -0.5 * (own - mean - mean[:, None] + mean.mean())
    values, vectors = np.linalg.eigh((centred + centred.T) / 2)
    project = vectors[:, -2:] / np.sqrt(np.maximum(values[-2:], 1e-18))
    return -0.5 * (square - mean[:, None]).T @ project


def _joined(samples: Samples, links: csr_matrix) -> csr_matrix:
    """Return the links, with bridges between pieces that are not connected."""
    while np.any(apart := connected_components(links, directed=False)[1] > 0):
        one, rest = np.flatnonzero(~apart), np.flatnonzero(apart)
        tree: Any = KDTree(samples.points[one])
        distance, nearest = tree.query(samples.points[rest])
        close = distance <= _BRIDGE * distance.min()
        row, column, length = rest[close], one[nearest[close]], distance[close]
        links = links + csr_matrix((length, (row, column)), shape=links.shape)
    return links


def _regression(row: Array, given: Array, wanted: Array, size: int) -> Array:
    """Return for each row the matrix that maps its ``given`` steps (L,G) to its ``wanted`` (L,W): (size,G,W)."""
    count, g, w = len(row), given.shape[1], wanted.shape[1]
    gathered = csr_matrix((np.ones(count), (row, np.arange(count))), shape=(size, count))
    own = (gathered @ (given[:, :, None] * given[:, None, :]).reshape(count, g * g)).reshape(size, g, g)
    both = (gathered @ (given[:, :, None] * wanted[:, None, :]).reshape(count, g * w)).reshape(size, g, w)
    own += (_RIDGE / g * np.trace(own, axis1=1, axis2=2) + 1e-18)[:, None, None] * np.eye(g)
    return np.linalg.solve(own, both)


def border(flat: Array) -> Array:
    """Return the closed border of points on a map.

    Half the density of the interior marks the border without bias, however noise blurs it; a hull of the outermost
    points would grow with the noise.

    Args:
        flat: ``(M, 2)`` metres, x right and y down.

    Returns:
        ``(P, 2)`` metres, evenly spread, clockwise.
    """
    low, high = flat.min(axis=0), flat.max(axis=0)
    pixel = max(float((high - low).max()) / _PIXELS, 1e-9)
    area = max(float(len(np.unique(np.floor((flat - low) / (4 * pixel)), axis=0))) * 16, 1.0)
    blur = max(float(np.sqrt(_UNDER_BLUR * area / (4 * np.pi * len(flat)))), _MIN_BLUR)
    margin = int(np.ceil(3 * blur)) + 1
    at = np.floor((flat - low) / pixel).astype(int) + margin
    width, height = (int(size) for size in at.max(axis=0) + margin + 1)
    count = np.bincount(at[:, 1] * width + at[:, 0], minlength=width * height).reshape(height, width)
    density = _blurred(count.astype(np.float32), blur)
    inside = (density > 0.3 * np.median(density[count > 0])).astype(np.float32)
    around = _blurred(density * inside, _WIDER * blur) / np.maximum(_blurred(inside, _WIDER * blur), 1e-3)
    share = density / np.maximum(around, 1e-6)
    fine = cv2.resize(share, None, fx=_FINER, fy=_FINER, interpolation=cv2.INTER_LINEAR)
    found = cv2.findContours((fine >= 0.5).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    # Through the centres of the outermost pixels: half a fine pixel inside of the level.
    contour = max(found, key=cv2.contourArea).reshape(-1, 2).astype(np.float64)
    placed = ((contour + 0.5) / _FINER - margin) * pixel + low
    even = FittedCurve.through(placed, np.zeros(len(placed), bool), closed=True).even(_POINTS)
    even = gaussian_filter1d(even, _SMOOTH, axis=0, mode="wrap")
    return even if clockwise(even) else even[::-1]


def _blurred(image: npt.NDArray[np.float32], sigma: float) -> npt.NDArray[np.float32]:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT), dtype=np.float32)
