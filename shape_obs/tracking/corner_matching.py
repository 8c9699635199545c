"""Match the corners of a sheet to those of the last frame, and choose the visible ones.

A hand over a corner leaves the outline with another one, some way inside. The three others are laid over where they
were expected by a similarity transform (S. Umeyama, "Least-Squares Estimation of Transformation Parameters Between Two
Point Patterns", 1991), and the fourth has to follow. The sides between visible corners keep their known lengths.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.coons import SIDE, flat_border

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]
Complexes = npt.NDArray[np.complex128]
Vector = tuple[float, float, float]

# Of half a diagonal. Cloths that bend and move by 30 px a frame stay below 0.025, a hand 12 px in radius makes 0.11.
STRAYED: Final = 0.06
# The choice of corners weighs the squares of these deviations: of all of them in place, as a share of half a diagonal;
# in radians of turn; in the logarithm of the scale. A hidden corner costs as much as three deviations; a side that is
# too long, with something over its middle, at most two.
_MOVED: Final = 0.3
_TURNED: Final = 0.35
_SCALED: Final = 0.15
_HIDDEN: Final = 3.0
_DETOUR: Final = 2.0
_LIES_OVER: Final = 0.3  # of the outline where a corner is hidden: next to so much of it something nearer is seen
_BULGE: Final = 0.3  # of the length of a fold: the outline lies off it by less
_STRAIGHT: Final = 3  # points of a side that give the direction in which it goes on
_NEAREST: Final = 5  # places among which each corner is looked for
_REACH: Final = 0.8  # of half a diagonal: no corner is looked for farther off


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


@compiled("(f8[:,::1], f8[:,::1], f8[::1], f8, f8[::1], f8[::1], f8)")
def assign_corners(
    expected: Array, places: Array, arcs: Array, whole: float, sides: Array, slack: Array, astray: float
) -> tuple[Indices, float]:
    """Return which of the places where an outline turns are the corners of a sheet; -1 for one that is hidden.

    Args:
        expected: ``(4, 2)`` pixels, predicted, clockwise.
        places: ``(Q, 2)`` pixels, clockwise around the outline.
        arcs: ``(Q,)`` their arc lengths along it, in the unit of the sides.
        whole: The outline's length.
        sides: ``(4,)`` the sheet's known lengths, from each corner to the next.
        slack: ``(4,)`` by which a length may be off.
        astray: By how much a corner may lie from where the others put it, as a share of half a diagonal.

    Returns:
        ``(4,)`` indices, at least two of them places; and the cost. All -1 if no choice is possible.
    """
    count = len(places)
    centre, reach = complex(0, 0), 0.0
    at, to = np.empty(4, np.complex128), np.empty(max(count, 1), np.complex128)
    for k in range(4):
        at[k] = complex(expected[k, 0], expected[k, 1])
        centre += at[k] / 4
    for k in range(4):
        reach = max(reach, abs(at[k] - centre))
    for q in range(count):
        to[q] = complex(places[q, 0], places[q, 1])
    near = np.full((4, _NEAREST), -1, np.int64)
    for k in range(4):
        far = np.full(_NEAREST, _REACH * reach)
        for q in range(count):
            away, to_put = abs(to[q] - at[k]), q
            for i in range(_NEAREST):  # insert it in order
                if away < far[i]:
                    away, far[i] = far[i], away
                    to_put, near[k, i] = near[k, i], to_put
    best, least, chosen = np.full(4, -1, np.int64), np.inf, np.empty(4, np.int64)
    for number in range((_NEAREST + 1) ** 4):
        rest, visible, possible = number, 0, True
        for k in range(4):
            i = rest % (_NEAREST + 1) - 1
            chosen[k] = near[k, i] if i >= 0 else -1
            possible = possible and (i < 0 or chosen[k] >= 0)
            rest //= _NEAREST + 1
            visible += chosen[k] >= 0
        if not possible or visible < 2:
            continue
        cost = _cost_of_corners(chosen, visible, at, to, arcs, whole, sides, slack, reach, astray)
        if cost < least:
            least = cost
            for k in range(4):
                best[k] = chosen[k]
    return best, least


@compiled
def _cost_of_corners(
    chosen: Indices, visible: int, at: Complexes, to: Complexes, arcs: Array, whole: float, sides: Array,
    slack: Array, reach: float, astray: float,
) -> float:  # fmt: skip
    """Return what a choice of corners costs, infinity if they are not in order; see ``assign_corners``."""
    before = after = product = complex(0, 0)
    around, spread, cost, last = 0.0, 1e-18, _HIDDEN * (4 - visible), -1
    for k in range(4):
        if chosen[k] >= 0:
            before, after, last = before + at[k] / visible, after + to[chosen[k]] / visible, k
    for k in range(4):
        if chosen[k] < 0:
            continue
        product += (at[k] - before).conjugate() * (to[chosen[k]] - after)
        spread += abs(at[k] - before) ** 2
        gap = (arcs[chosen[k]] - arcs[chosen[last]]) % whole
        around += gap
        if gap <= 0:
            return np.inf
        if (last + 1) % 4 == k:
            off = (gap - sides[last]) / slack[last]
            cost += min(off * off, _DETOUR) if off > 0 else off * off
        last = k
    product /= spread
    if around > 1.5 * whole or abs(product) < 0.5:
        return np.inf
    for k in range(4):
        if chosen[k] >= 0:
            cost += (abs(to[chosen[k]] - after - product * (at[k] - before)) / (astray * reach)) ** 2
    cost += (abs(after - before) / (_MOVED * reach)) ** 2 + (math.log(abs(product)) / _SCALED) ** 2
    return float(cost + (math.atan2(product.imag, product.real) / _TURNED) ** 2)


def folded_piece(
    points: Array, seen: Mask, k: int, space: Array, cut: Mask, sides: Array, slack: Array
) -> tuple[int, int] | None:
    """Return the last point seen before a folded corner and the first one behind it; None if it is not folded.

    Nothing lies over a folded corner. The outline runs straight along the fold, and both ends of it lie as far from
    each other as in the flat sheet; those of a side that has buckled come nearer.
    """
    away = np.arange(1, 2 * SIDE)
    before, behind = seen[(SIDE * k - away) % len(seen)], seen[(SIDE * k + away) % len(seen)]
    if not (before.any() and behind.any()):
        return None
    first, last = SIDE * k - 1 - int(np.argmax(before)), SIDE * k + 1 + int(np.argmax(behind))
    begin, end = (int(np.argmin(((space - points[p % len(points)]) ** 2).sum(axis=1))) for p in (first, last))
    between = (begin + np.arange((end - begin) % len(cut) + 1)) % len(cut)
    flat = flat_border(sides)
    material = float(np.linalg.norm(flat[last % len(flat)] - flat[first % len(flat)]))
    chord, away = space[end] - space[begin], space[between] - space[begin]
    length = max(float(np.linalg.norm(chord)), 1e-9)
    bulge = np.linalg.norm(away - (away @ chord)[:, None] / length**2 * chord, axis=1).max()
    straight = bulge < _BULGE * length and abs(length - material) < slack.max()
    return (first, last) if straight and cut[between].mean() <= _LIES_OVER else None


def unfold(points: Array, first: int, last: int, corner: int, sides: Array) -> None:
    """Lay a folded corner flat: its sides go on straight, as long as they are known to be."""
    count, places = len(points), []
    for at, way, side in ((first, -1, corner // SIDE - 1), (last, 1, corner // SIDE)):
        ahead = points[at % count] - points[(at + way * _STRAIGHT) % count]
        length = abs(corner - at) / SIDE * sides[side]
        places.append(points[at % count] + length / max(float(np.linalg.norm(ahead)), 1e-9) * ahead)
    apex = (places[0] + places[1]) / 2
    for at in (first, last):
        share = np.arange(1, abs(corner - at) + 1)[:, None] / abs(corner - at)
        index = (at + np.sign(corner - at) * np.arange(1, abs(corner - at) + 1)) % count
        points[index] = points[at % count] + share * (apex - points[at % count])
