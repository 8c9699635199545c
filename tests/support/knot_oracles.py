"""Knots from closed polygons in space, by brute force: crossings and the Alexander determinant."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Cross(NamedTuple):
    """Curves and positions, in pieces and shares of a piece, of the upper and the lower strand; the crossing's sign."""

    over: tuple[int, float]
    under: tuple[int, float]
    sign: int


def crossings_in_space(curves: Sequence[Array], closed: bool) -> list[Cross]:
    """Return all crossings of curves (P, 3) as seen from above, in pixels with v down."""
    starts = [np.concatenate([c, c[:1]]) if closed else c for c in curves]
    found = []
    for (k, one), (m, other) in itertools.combinations_with_replacement(enumerate(starts), 2):
        step, far = np.diff(one, axis=0), np.diff(other, axis=0)
        offset = other[None, :-1] - one[:-1, None]
        area = step[:, None, 0] * far[None, :, 1] - step[:, None, 1] * far[None, :, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            s = (offset[..., 0] * far[None, :, 1] - offset[..., 1] * far[None, :, 0]) / area
            t = (offset[..., 0] * step[:, None, 1] - offset[..., 1] * step[:, None, 0]) / area
        hit = (np.abs(area) > 1e-9) & (s >= 0) & (s < 1) & (t >= 0) & (t < 1)
        if k == m:
            hit &= np.triu(np.ones(hit.shape, bool), 2)
            hit[0, -1] &= not closed
        for i, j in np.argwhere(hit):
            z = one[i, 2] + s[i, j] * step[i, 2], other[j, 2] + t[i, j] * far[j, 2]
            first, second = (k, float(i + s[i, j])), (m, float(j + t[i, j]))
            hand = 1 if area[i, j] > 0 else -1
            found.append(Cross(first, second, -hand) if z[0] > z[1] else Cross(second, first, hand))
    return found


def closed_above(rope: Array) -> Array:
    """Return an open rope closed far above everything: (P, 3)."""
    top = np.ptp(rope[:, 2]) + rope[:, 2].max() + 10.0
    lift = np.array([1.0, 1.0, 0.0])
    return np.concatenate([rope, [rope[-1] * lift + [0.01, 0.02, top], rope[0] * lift + [0.01, 0.01, top]]])


def determinant(curves: Sequence[Array]) -> int:
    """Return the Alexander polynomial at -1, up to its sign.

    That of curves that can be pulled apart is 0. From Wirtinger's relations at the crossings: J. W. Alexander,
    "Topological Invariants of Knots and Links", 1928.
    """
    crossings = crossings_in_space(curves, closed=True)
    cuts = sorted(c.under for c in crossings)
    if any(all(k != own for k, _ in cuts) for own in range(len(curves))):
        return 0 if len(curves) > 1 else 1

    def arc(at: tuple[int, float]) -> int:
        own = [n for n, cut in enumerate(cuts) if cut[0] == at[0]]
        before = [n for n in own if cuts[n][1] < at[1]]
        return before[-1] if before else own[-1]

    matrix = np.zeros((len(crossings), len(cuts)))
    for row, c in zip(matrix, crossings, strict=True):
        row[arc(c.over)] += 2
        row[cuts.index(c.under)] -= 1
        row[arc(c.under)] -= 1
    return abs(round(np.linalg.det(matrix[1:, 1:])))
