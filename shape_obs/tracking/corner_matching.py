"""Match the corners of a sheet to those of the last frame, and notice one that something hides.

A hand over a corner leaves the outline with another one, some way inside. The three others are laid over where they
were expected by a similarity transform (S. Umeyama, "Least-Squares Estimation of Transformation Parameters Between Two
Point Patterns", 1991), and the fourth has to follow.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.lattice import outer_corners, transposed

Array = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]
Vector = tuple[float, float, float]

# Of half a diagonal. Cloths that bend and move by 30 px a frame stay below 0.025, a hand 12 px in radius makes 0.11.
STRAYED: Final = 0.06


@compiled("(f8[:,:,::1], f8[:,:,::1])")
def match_lattice(lattice: Array, expected: Array) -> tuple[Array, int, float]:
    """Turn a lattice so that its corners lie nearest to those that are expected.

    Args:
        lattice: ``(R, C, D)``.
        expected: ``(R', C', D)`` predicted nodes, at the centres of equal pieces; ``(0, 0, 2)`` without any.

    Returns:
        The lattice, then which corner strays most, and by which share of half a diagonal: see ``match_corners``.
    """
    if len(expected) == 0:
        return lattice, 0, 0.0
    rows, cols, dimension = lattice.shape
    found = np.empty((4, dimension))
    for d in range(dimension):
        found[0, d], found[1, d] = lattice[0, 0, d], lattice[0, cols - 1, d]
        found[2, d], found[3, d] = lattice[rows - 1, cols - 1, d], lattice[rows - 1, 0, d]
    quarters, corner, share = match_corners(outer_corners(expected), found)
    for _ in range(quarters):
        lattice = transposed(lattice)[::-1].copy()
    return lattice, corner, share


@compiled("(f8[:,::1], f8[:,::1])")
def match_corners(expected: Array, corners: Array) -> tuple[int, int, float]:
    """Return how a sheet's corners are numbered, and which one lies farthest from where the other three put it.

    The similarity transform of complex numbers is one product: the least squares of ``found = a expected + b``.

    Args:
        expected: ``(4, D)`` predicted corners, clockwise.
        corners: ``(4, D)`` found.

    Returns:
        By how many quarters the found lattice is to be turned, so that its corners lie nearest to the predicted
        ones; then which of them strays most, and by which share of half a diagonal.
    """
    dimension = corners.shape[1]
    quarters, least = 0, np.inf
    for turn in range(4):
        square = 0.0
        for k in range(4):
            for d in range(dimension):
                square += (corners[(k + turn) % 4, d] - expected[k, d]) ** 2
        if square < least:
            quarters, least = turn, square
    found, middle = np.empty((4, dimension)), np.zeros(dimension)
    for k in range(4):
        for d in range(dimension):
            found[k, d] = corners[(k + quarters) % 4, d]
            middle[d] += found[k, d] / 4
    worst, most, reach = 0, -1.0, 1e-18
    for k in range(4):
        before, rise_before = _seen_by_the_others(expected, k)
        after, rise_after = _seen_by_the_others(found, k)
        product, spread, square = 0j, 1e-18, 0.0
        for j in range(4):
            if j != k:
                product += before[j].conjugate() * after[j]
                spread += before[j].real ** 2 + before[j].imag ** 2
        product /= spread
        astray = math.hypot(abs(before[k] * product - after[k]), rise_before * abs(product) - rise_after)
        if astray > most:
            worst, most = k, astray
        for d in range(dimension):
            square += (found[k, d] - middle[d]) ** 2
        reach = max(reach, square)
    return quarters, worst, most / math.sqrt(reach)


@compiled
def _seen_by_the_others(corners: Array, k: int) -> tuple[Complexes, float]:
    """Return ``(4,)`` corners as complex numbers in the plane of all but the k-th, and how far that one lies above."""
    away = np.zeros((4, 3))
    for d in range(corners.shape[1]):
        middle = (corners[k - 1, d] + corners[k - 2, d] + corners[k - 3, d]) / 3
        for j in range(4):
            away[j, d] = corners[j, d] - middle
    right, normal = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    if corners.shape[1] == 3:
        right = _unit(away[k - 1, 0], away[k - 1, 1], away[k - 1, 2])
        normal = _unit(*_cross(right, (away[k - 2, 0], away[k - 2, 1], away[k - 2, 2])))
    up = _cross(normal, right)
    seen = np.empty(4, np.complex128)
    for j in range(4):
        x, y, z = away[j, 0], away[j, 1], away[j, 2]
        seen[j] = complex(x * right[0] + y * right[1] + z * right[2], x * up[0] + y * up[1] + z * up[2])
    return seen, away[k, 0] * normal[0] + away[k, 1] * normal[1] + away[k, 2] * normal[2]


@compiled
def _unit(x: float, y: float, z: float) -> Vector:
    """Return a vector of length 1; zeros for zeros."""
    length = max(math.sqrt(x * x + y * y + z * z), 1e-18)
    return x / length, y / length, z / length


@compiled
def _cross(a: Vector, b: Vector) -> Vector:
    """Return the cross product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
