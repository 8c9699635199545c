"""Triangles drawn into an image without OpenGL: which of them each pixel's centre sees, and how deep."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_GRAZE = 1e-9  # pixels: centres on a shared edge belong to both of its triangles, to neither of them never


class Drawn(NamedTuple):
    """The pixels that triangles cover.

    Args:
        pixels: (P,) flat indices into the image, each once.
        faces: (P,) the nearest triangle there.
        shares: (P, 3) of its vertices at that place, in space: shares @ values interpolates on the triangle.
        depth: (P,) along the optical axis [m].
    """

    pixels: Indices
    faces: Indices
    shares: Array
    depth: Array


def draw_triangles(places: Array, depth: Array, faces: Indices, shape: tuple[int, int]) -> Drawn:
    """Draw triangles as OpenGL does: by pixel centres, the nearest wins, interpolated in space.

    Args:
        places: (V, 2) pixels of the vertices, centres at integers.
        depth: (V,) of the vertices along the optical axis [m], above 0.
        faces: (F, 3) vertices of the triangles, in either sense.
        shape: (H, W) of the image.
    """
    corners, near = places[faces], 1 / depth[faces]
    edges = _edges(corners)
    area = np.einsum("fk,fk->f", edges[:, 0, :2], corners[:, 0]) + edges[:, 0, 2]
    whole = np.abs(area) > 1e-12  # seen edge on there is nothing to see
    edges = edges[whole] / area[whole, None, None]
    face, v, start, count = _spans(corners[whole], edges, shape)
    span = np.repeat(np.arange(len(face)), count)
    u = start[span] + np.arange(len(span)) - np.repeat(np.cumsum(count) - count, count)
    face, v = face[span], v[span]
    # 1/z is linear over the image
    plane = np.einsum("fkc,fk->fc", edges, near[whole])[face]
    inverse = plane[:, 0] * u + plane[:, 1] * v + plane[:, 2]
    pixels = v * shape[1] + u
    nearest = np.zeros(shape[0] * shape[1])
    np.maximum.at(nearest, pixels, inverse)
    wins = np.flatnonzero(inverse == nearest[pixels])
    winner = np.full(len(nearest), -1)
    winner[pixels[wins]] = wins
    pixels = np.flatnonzero(winner >= 0)
    wins = winner[pixels]
    face, inverse = face[wins], inverse[wins]
    flat = np.einsum("pkc,cp->pk", edges[face], np.stack([u[wins], v[wins], np.ones(len(wins))]))
    shares = flat * near[whole][face] / inverse[:, None]
    return Drawn(pixels, np.flatnonzero(whole)[face], shares, 1 / inverse)


def _edges(corners: Array) -> Array:
    """(F, 3, 3) lines through the corners opposite to each: line . (u, v, 1) is the corner's share times the area."""
    first, second = np.roll(corners, -1, axis=1), np.roll(corners, -2, axis=1)
    out = np.empty((len(corners), 3, 3))
    out[..., 0] = first[..., 1] - second[..., 1]
    out[..., 1] = second[..., 0] - first[..., 0]
    out[..., 2] = first[..., 0] * second[..., 1] - second[..., 0] * first[..., 1]
    return out


def _spans(corners: Array, edges: Array, shape: tuple[int, int]) -> tuple[Indices, Indices, Indices, Indices]:
    """Rows of pixels within triangles: face, row v, first column u, and how many."""
    low = np.maximum(np.ceil(corners[..., 1].min(axis=1) - _GRAZE), 0).astype(np.int64)
    high = np.minimum(np.floor(corners[..., 1].max(axis=1) + _GRAZE), shape[0] - 1).astype(np.int64)
    count = np.maximum(high - low + 1, 0)
    face = np.repeat(np.arange(len(corners)), count)
    v = low[face] + np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    # inside: a u + b v + c >= 0 for each edge
    slope = edges[face, :, 0]
    rest = edges[face, :, 1] * v[:, None] + edges[face, :, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        cross = -rest / slope
    start = np.where(slope > 0, cross, -np.inf).max(axis=1)
    end = np.where(slope < 0, cross, np.inf).min(axis=1)
    start = np.maximum(np.ceil(start - _GRAZE), 0)
    end = np.minimum(np.floor(end + _GRAZE), shape[1] - 1)
    inside = ((slope != 0) | (rest >= -_GRAZE)).all(axis=1) & (end >= start)
    start, end = start[inside].astype(np.int64), end[inside].astype(np.int64)
    return face[inside], v[inside], start, end - start + 1
