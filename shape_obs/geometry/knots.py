"""Decide whether a rope is knotted, by its Jones polynomial, and whether a rope can be lifted off another one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.crossings import Crossing, Visit, gauss_code
from shape_obs.geometry.knot_diagram import ABOVE, BELOW, Diagram, is_planar, reduced, with_arc

# Up to so many crossings no knot but the unknot has its Jones polynomial: R. E. Tuzun and A. S. Sikora, "Verification
# of the Jones Unknot Conjecture up to 24 Crossings", 2021.
_DETECTED: Final = 24
_MOST: Final = 32  # crossings of a closed diagram; the polynomial takes too long beyond
_MOST_UNKNOWN: Final = 8  # crossings of which the upper strand is tried both ways

#: Coefficients by exponent.
Polynomial = dict[int, int]

_Edge = tuple[int, int]
_Ends = tuple[tuple[_Edge, _Edge], ...]
_Row = npt.NDArray[np.int64]

#: The polynomial of a circle without crossings.
CIRCLE: Final[Polynomial] = {2: -1, -2: -1}


def reduced_code(crossings: Sequence[Crossing], name: str) -> tuple[Visit, ...]:
    """Return the Gauss code of a rope after Reidemeister's moves, with the numbers of ``gauss_code``.

    An end that lies on other strands is drawn back first, see ``is_knotted``. The code is empty if the moves that were
    tried undo all crossings. Crossings of which the upper strand is unknown are only untwisted, or crossed by moves
    that are possible whichever is above.
    """
    rope = _rope(crossings, name)
    letters = dict(zip(rope.strands[0], gauss_code(crossings, name), strict=True))
    return tuple(letters[at] for at in reduced(rope).strands[0])


def is_knotted(crossings: Sequence[Crossing], name: str) -> bool | None:
    """Return whether a rope is knotted when both ends are lifted towards the camera and pulled taut.

    Every open rope can be unknotted by its ends. What is meant here is the knot that is closed by an arc from end to
    end that passes above everything, the overpass closure of V. Turaev, "Knotoids", 2012: that of a rope whose ends two
    grippers take from above. An end that lies on the rope is free, therefore, while one that is tucked under the
    rope's last strand is not. Where both ends lie outside the figure, an arc around it gives the same knot.

    No is proven by moves that undo all crossings, or by a Jones polynomial of 1 in a closed diagram of up to 24
    crossings; yes by any other Jones polynomial.

    Args:
        crossings: All that the rope has with itself; those with others are ignored.
        name: Of the rope.

    Returns:
        None if the answer depends on crossings of which the upper strand is unknown, or if there are more than eight of
        them after the moves; if no curve has such a code, because crossings are missing (of drawn knots without one
        crossing, a fifth have a code that another curve has, and are not noticed); or if more than 32 crossings (24
        for a polynomial of 1) remain.
    """
    diagram = _rope(crossings, name)
    return _decided(diagram, _knotted) if is_planar(diagram) else None


def lifts_off(crossings: Sequence[Crossing], name: str, other: str) -> bool | None:
    """Return whether a rope that is lifted by both ends comes off another one that stays where it lies.

    That is whether they come apart as a link, if the ends of the lifted rope are joined by an arc above everything and
    those of the other by an arc below everything. Other ropes are ignored. A rope that lies on another one everywhere
    comes off it; one that lies under it once does not, though it might be pulled out lengthwise.

    Yes is proven by moves that undo all crossings between both; no by the linking number, or by a Jones polynomial
    that is not the product of those of the two.

    Returns:
        None as for ``is_knotted``, and if the moves leave crossings between both, but the polynomials do not differ.
    """
    diagram = Diagram.of(crossings, (name, other), (ABOVE, BELOW))
    return _decided(diagram, _apart) if is_planar(diagram) else None


def are_hooked(crossings: Sequence[Crossing], name: str, other: str) -> bool | None:
    """Return whether neither of two ropes can be lifted off the other, see ``lifts_off``; None if unknown."""
    answers = lifts_off(crossings, name, other), lifts_off(crossings, other, name)
    if True in answers:
        return False
    return None if None in answers else True


def _rope(crossings: Sequence[Crossing], name: str) -> Diagram:
    return Diagram.of(crossings, (name,), (ABOVE,))


def _decided(diagram: Diagram, answer: Callable[[Diagram], bool | None], depth: int = 0) -> bool | None:
    """Return the answer for a diagram, if it is the same for both levels of each unknown crossing."""
    diagram = reduced(diagram)
    at = diagram.unknown()
    if at is None or diagram.count == 0:
        return answer(diagram)
    if depth == _MOST_UNKNOWN:
        return None
    over = _decided(diagram.decided(at, 1), answer, depth + 1)
    return over if over is not None and over == _decided(diagram.decided(at, -1), answer, depth + 1) else None


def _knotted(diagram: Diagram) -> bool | None:
    """Return whether a reduced strand is knotted."""
    if diagram.count == 0:
        return False
    knot = with_arc(diagram, 0)
    if knot.count > _MOST:
        return None
    if jones_polynomial(knot) != CIRCLE:
        return True
    return False if knot.count <= _DETECTED else None


def _apart(diagram: Diagram) -> bool | None:
    """Return whether the first of two reduced strands comes off the second."""
    under = [at for at in diagram.strands[0] if at ^ 1 in diagram.strands[1] and diagram.levels[at] < 0]
    if not any(at ^ 1 in diagram.strands[1] for at in diagram.strands[0]):
        return True
    # The arcs lie above and below everything, so that these crossings are all that the linking number counts.
    if sum(diagram.sides[at] for at in under) != 0:
        return False
    link = with_arc(with_arc(diagram, 0), 1)
    if link.count > _MOST:
        return None
    parts = product(jones_polynomial(link.only(0)), jones_polynomial(link.only(1)))
    return None if jones_polynomial(link) == parts else False


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
