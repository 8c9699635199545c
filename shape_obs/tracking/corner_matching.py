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
from shape_obs.geometry.lattice import outer_corners

Array = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

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
    found = np.empty((4, lattice.shape[2]))
    found[0], found[1], found[2], found[3] = lattice[0, 0], lattice[0, -1], lattice[-1, -1], lattice[-1, 0]
    quarters, corner, share = match_corners(outer_corners(expected), found)
    return np.ascontiguousarray(np.rot90(lattice, quarters)), corner, share


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
    found, away = np.concatenate((corners, corners)), np.empty(4)
    for turn in range(4):
        away[turn] = ((found[turn : turn + 4] - expected) ** 2).sum()
    quarters = int(np.argmin(away))
    found = found[quarters : quarters + 4]
    middle = (found[0] + found[1] + found[2] + found[3]) / 4
    reach, astray = 1e-9, np.empty(4)
    for k in range(4):
        before, rise_before = _seen_by_the_others(expected, k)
        after, rise_after = _seen_by_the_others(found, k)
        product, spread = 0j, 0.0
        for j in range(4):
            if j != k:
                product += before[j].conjugate() * after[j]
                spread += before[j].real ** 2 + before[j].imag ** 2
        product /= max(spread, 1e-18)
        astray[k] = math.hypot(abs(before[k] * product - after[k]), rise_before * abs(product) - rise_after)
        reach = max(reach, math.sqrt(((found[k] - middle) ** 2).sum()))
    worst = int(np.argmax(astray))
    return quarters, worst, astray[worst] / reach


@compiled
def _seen_by_the_others(corners: Array, k: int) -> tuple[Complexes, float]:
    """Return ``(4,)`` corners as complex numbers in the plane of all but the k-th, and how far that one lies above."""
    away = corners - (corners[k - 1] + corners[k - 2] + corners[k - 3]) / 3
    if corners.shape[1] == 2:
        return away[:, 0] + 1j * away[:, 1], 0.0
    right, normal = away[k - 1], np.cross(away[k - 1], away[k - 2])
    right, normal = right / max(np.sqrt((right**2).sum()), 1e-18), normal / max(np.sqrt((normal**2).sum()), 1e-18)
    up = np.cross(normal, right)
    return (away * right).sum(axis=1) + 1j * (away * up).sum(axis=1), (away[k] * normal).sum()
