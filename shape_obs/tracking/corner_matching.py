"""Match the corners of a sheet to those of the last frame, and notice one that something hides.

A hand over a corner leaves the outline with another one, some way inside. The three others are laid over where they
were expected by a similarity transform (S. Umeyama, "Least-Squares Estimation of Transformation Parameters Between Two
Point Patterns", 1991), and the fourth has to follow.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled

Array = npt.NDArray[np.float64]

# Of half a diagonal. Cloths that bend and move by 30 px a frame stay below 0.025, a hand 12 px in radius makes 0.11.
STRAYED: Final = 0.06


def match_corners_in_space(expected: Array, corners: Array) -> tuple[int, int, float]:
    """Return what ``match_corners`` returns, for ``(4, 3)`` corners in space."""
    away = [np.sum((np.roll(corners, -turn, axis=0) - expected) ** 2) for turn in range(4)]
    quarters = int(np.argmin(away))
    found = np.roll(corners, -quarters, axis=0)
    reach = float(np.linalg.norm(found - found.mean(axis=0), axis=1).max())
    astray = [_astray(expected, found, corner) / max(reach, 1e-9) for corner in range(4)]
    worst = int(np.argmax(astray))
    return quarters, worst, astray[worst]


def _astray(expected: Array, found: Array, corner: int) -> float:
    """Return how far a corner lies from where a similarity transform of the other three puts it."""
    others = np.arange(4) != corner
    before, after = expected[others].mean(axis=0), found[others].mean(axis=0)
    source, target = expected[others] - before, found[others] - after
    u, overlap, v = np.linalg.svd(source.T @ target)
    sign = np.ones(len(overlap))
    sign[-1] = np.sign(np.linalg.det(u @ v))
    turn = (u * sign) @ v * (overlap @ sign / max(float(np.sum(source**2)), 1e-18))
    return float(np.linalg.norm((expected[corner] - before) @ turn + after - found[corner]))


@compiled
def match_corners(expected: Array, corners: Array) -> tuple[int, int, float]:
    """Return how a sheet's corners are numbered, and which one lies farthest from where the other three put it.

    The similarity transform of complex numbers is one product: the least squares of ``found = a expected + b``.

    Args:
        expected: ``(4, 2)`` predicted corners, clockwise.
        corners: ``(4, 2)`` found.

    Returns:
        By how many quarters the found lattice is to be turned, so that its corners lie nearest to the predicted
        ones; then which of them strays most, and by which share of half a diagonal.
    """
    quarters, least = 0, np.inf
    for turn in range(4):
        square = 0.0
        for k in range(4):
            for d in range(2):
                square += (corners[(k + turn) % 4, d] - expected[k, d]) ** 2
        if square < least:
            quarters, least = turn, square
    past, here = np.empty(4, np.complex128), np.empty(4, np.complex128)
    for k in range(4):
        past[k] = complex(expected[k, 0], expected[k, 1])
        here[k] = complex(corners[(k + quarters) % 4, 0], corners[(k + quarters) % 4, 1])
    middle, reach = here.sum() / 4, 1e-9
    for k in range(4):
        reach = max(reach, abs(here[k] - middle))
    worst, most = 0, -1.0
    for k in range(4):
        before, after = (past.sum() - past[k]) / 3, (here.sum() - here[k]) / 3
        product, spread = 0j, 0.0
        for j in range(4):
            if j != k:
                source = past[j] - before
                product += source.conjugate() * (here[j] - after)
                spread += source.real**2 + source.imag**2
        astray = abs((past[k] - before) * (product / max(spread, 1e-18)) + after - here[k])
        if astray > most:
            worst, most = k, astray
    return quarters, worst, most / reach
