"""The Jones polynomial of a closed diagram."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.knot_diagram import Diagram

#: Coefficients by exponent.
Polynomial = dict[int, int]

_Edge = tuple[int, int]
_Ends = tuple[tuple[_Edge, _Edge], ...]
_Row = npt.NDArray[np.int64]

#: The polynomial of a circle without crossings.
CIRCLE: Final[Polynomial] = {2: -1, -2: -1}


def jones_polynomial(diagram: Diagram) -> Polynomial:
    """Return the Jones polynomial of a closed diagram in A = t^(-1/4), times that of a circle, ``-A^2 - A^-2``.

    It is the same for all diagrams of a knot or link. That of two links that lie apart is the product of theirs.

    The bracket of L. Kauffman, "State Models and the Jones Polynomial", 1987, is summed up crossing by crossing: the
    diagrams in which the crossings so far are smoothed differ only in how the open edges are joined, which are few
    (D. Bar-Natan, "Fast Khovanov Homology Computations", 2007, section 6).

    Raises:
        ValueError: A strand is open, or it is unknown which strand of a crossing is above.
    """
    if not all(diagram.closed) or diagram.unknown() is not None:
        raise ValueError("the Jones polynomial is defined for closed strands of which it is known which are above.")
    corners = _corners(diagram)
    # No term lies further from the middle.
    middle = 3 * len(corners) + 2 * len(diagram.strands) + 2
    one = np.zeros(2 * middle + 1, np.int64)
    one[middle] = 1
    for strand in diagram.strands:
        if not strand:
            one = _circle(one)
    states: dict[_Ends, _Row] = {(): one}
    frontier: set[_Edge] = set()
    while corners:
        # The crossing with most edges to what has been done keeps the number of states small.
        nearest = max(corners, key=lambda c: len(frontier.intersection(corners[c])))
        a, b, c, d = corners.pop(nearest)
        for edge in (a, b, c, d):
            frontier ^= {edge}
        sums: dict[_Ends, _Row] = {}
        for ends, row in states.items():
            for power, joins in ((1, ((a, b), (c, d))), (-1, ((a, d), (c, b)))):
                joined, circles = _joined(ends, joins)
                term = np.roll(row, power)
                for _ in range(circles):
                    term = _circle(term)
                sums[joined] = sums[joined] + term if joined in sums else term
        states = sums
    (row,) = states.values()
    passages = [at for strand in diagram.strands for at in strand]
    writhe = sum(diagram.levels[at] * diagram.sides[at] for at in passages) // 2
    sign = -1 if writhe % 2 else 1
    return {int(p) - middle - 3 * writhe: sign * int(row[p]) for p in np.flatnonzero(row)}


def product(one: Polynomial, other: Polynomial) -> Polynomial:
    """Return the product of two polynomials."""
    result: Polynomial = {}
    for p, x in one.items():
        for q, y in other.items():
            result[p + q] = result.get(p + q, 0) + x * y
    return {p: x for p, x in result.items() if x}


def _corners(diagram: Diagram) -> dict[int, tuple[_Edge, _Edge, _Edge, _Edge]]:
    """Return the edges at each crossing: over out, under right, over in, under left, as seen along the upper strand.

    The smoothing that Kauffman weights with A joins the first two, and the last two.
    """
    before: dict[int, _Edge] = {}
    after: dict[int, _Edge] = {}
    for s, strand in enumerate(diagram.strands):
        for i, at in enumerate(strand):
            before[at], after[at] = (s, i), (s, (i + 1) % len(strand))
    corners = {}
    for at in before:
        if diagram.levels[at] > 0:
            right, left = before[at ^ 1], after[at ^ 1]
            if diagram.sides[at] < 0:
                right, left = left, right
            corners[at // 2] = after[at], right, before[at], left
    return corners


def _joined(ends: _Ends, joins: tuple[tuple[_Edge, _Edge], ...]) -> tuple[_Ends, int]:
    """Return the pairs of open edges after two are joined, twice, and how many circles were closed by it."""
    partner = {one: other for pair in ends for one, other in (pair, pair[::-1])}
    circles = 0
    for one, other in joins:
        if one == other or partner.get(one) == other:
            partner.pop(one, None)
            partner.pop(other, None)
            circles += 1
            continue
        far, beyond = partner.pop(one, one), partner.pop(other, other)
        partner[far], partner[beyond] = beyond, far
    return tuple(sorted((one, other) for one, other in partner.items() if one < other)), circles


def _circle(row: _Row) -> _Row:
    """Return a row of coefficients times ``-A^2 - A^-2``."""
    return -np.roll(row, 2) - np.roll(row, -2)
