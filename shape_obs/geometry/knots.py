"""Decide whether a rope is knotted, and whether a rope can be lifted off another one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from shape_obs.geometry.crossings import Crossing, Visit, gauss_code
from shape_obs.geometry.knot_diagram import ABOVE, BELOW, Diagram, is_planar, reduced, with_arc
from shape_obs.geometry.knot_polynomial import CIRCLE, jones_polynomial, product

# Up to so many crossings no knot but the unknot has its Jones polynomial: R. E. Tuzun and A. S. Sikora, "Verification
# of the Jones Unknot Conjecture up to 24 Crossings", 2021.
_DETECTED: Final = 24
_MOST: Final = 32  # crossings of a closed diagram; the polynomial takes too long beyond
_MOST_UNKNOWN: Final = 8  # crossings of which the upper strand is tried both ways


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
