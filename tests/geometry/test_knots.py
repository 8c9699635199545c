"""Knotted and unknotted ropes against invariants that are computed from the curve in space."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from drawn_knots import KNOTS, UNKNOTS, DrawnKnot, drawn_knot, with_heights
from knot_oracles import closed_above, crossings_in_space, determinant

from shape_obs.geometry.crossings import Crossing, format_code, gauss_code
from shape_obs.geometry.intersections import find_crossings
from shape_obs.geometry.knot_diagram import ABOVE, BELOW, Diagram, is_planar, reduced, with_arc
from shape_obs.geometry.knots import CIRCLE, are_hooked, is_knotted, jones_polynomial, lifts_off, product, reduced_code

# By exponents of t: V. F. R. Jones, "Hecke Algebra Representations of Braid Groups", 1987.
JONES_OF_TREFOIL = {1: 1, 3: 1, 4: -1}
# Determinants: KnotInfo.
DETERMINANT = {"trefoil": 3, "figure eight": 5, "5_1": 5, "5_2": 7, "6_2": 11, "6_3": 13, "8_19": 3}
DETERMINANT |= {"granny": 9, "square": 9} | dict.fromkeys(UNKNOTS, 1)
NAMES = [*KNOTS, *UNKNOTS]
COUNT = 40
_T, _RADIUS = np.linspace(0.02, 2 * np.pi - 0.02, 300), 2 + np.cos(3 * np.linspace(0.02, 2 * np.pi - 0.02, 300))
TREFOIL = np.stack([_RADIUS * np.cos(2 * _T), _RADIUS * np.sin(2 * _T), np.sin(3 * _T)], axis=1)  # right-handed


@cache
def drawn(k: int) -> tuple[DrawnKnot, tuple[Crossing, ...]]:
    knot = drawn_knot(np.random.default_rng(k), NAMES[k % len(NAMES)])
    found = find_crossings([knot.curve], ["rope"])
    return knot, with_heights(found, [knot.curve], [knot.heights], ["rope"])


def seen(*curves, names="ab"):
    """Crossings of curves (P, 3)."""
    names = list(names[: len(curves)])
    flat = [np.asarray(c, float)[:, :2] for c in curves]
    return with_heights(find_crossings(flat, names), flat, [np.asarray(c, float)[:, 2] for c in curves], names)


def in_space(knot):
    return np.column_stack([knot.curve, knot.heights])


def diagram(crossings, name="rope"):
    return Diagram.of(crossings, (name,), (ABOVE,))


def jones(crossings, name="rope"):
    return jones_polynomial(with_arc(diagram(crossings, name), 0))


@pytest.mark.parametrize("k", range(COUNT))
def test_drawn_knots(k):
    """Codes, knottedness and the determinant of each are those of the curve in space."""
    knot, crossings = drawn(k)
    rope = in_space(knot)
    true = crossings_in_space([rope], closed=False)
    ends = sorted((end, side, n) for n, c in enumerate(true) for side, end in (("U", c.under), ("O", c.over)))
    number: dict[int, int] = {}
    letters = [f"{side}{number.setdefault(n, len(number) + 1)}{'-+'[true[n].sign > 0]}" for _, side, n in ends]
    assert format_code(gauss_code(crossings, "rope")) == " ".join(letters)
    assert is_planar(diagram(crossings))
    assert is_knotted(crossings, "rope") is knot.knotted
    assert determinant([closed_above(rope)]) == DETERMINANT[knot.name]
    if not reduced_code(crossings, "rope"):
        assert not knot.knotted


def test_a_right_handed_trefoil():
    crossings = seen(TREFOIL)
    assert format_code(gauss_code(crossings, "a")) == "O1+ U2+ O3+ U1+ O2+ U3+"
    # The first passage lies over the rope, so that the end is drawn back.
    assert format_code(reduced_code(crossings, "a")) == "U2+ O3+ O2+ U3+"
    assert is_knotted(crossings, "a") is True
    assert jones(crossings, "a") == product({-4 * p: x for p, x in JONES_OF_TREFOIL.items()}, CIRCLE)
    mirror = seen(TREFOIL * [1, 1, -1])
    assert format_code(gauss_code(mirror, "a")) == "U1- O2- U3- O1- U2- O3-"
    assert is_knotted(mirror, "a") is is_knotted(seen(TREFOIL[::-1]), "a") is True


def test_an_end_on_the_rope_is_free_and_an_end_under_it_is_not():
    """An overhand knot of which one end has just passed the last strand."""
    last = max(c.arcs[1] for c in seen(TREFOIL))
    short = TREFOIL[: int(300 * (last - 0.01))]  # the last passage is under: cut before it
    assert is_knotted(seen(short), "a") is False
    assert is_knotted(seen(TREFOIL), "a") is True


def test_unknown_crossings_matter_only_where_the_answer_depends_on_them():
    trefoil = seen(TREFOIL)
    for k in range(3):  # with one crossing changed a trefoil is no knot
        some = [c._replace(above=None) if n == k else c for n, c in enumerate(trefoil)]
        assert is_knotted(some, "a") is None
        assert "?" in format_code(gauss_code(some, "a"))
    loop = [c._replace(above=None) for c in seen([[0, 0, 0], [10, 0, 0], [10, 10, 1], [5, 10, 1], [5, -5, 1]])]
    assert is_knotted(loop, "a") is False
    assert reduced_code(loop, "a") == ()
    # A granny with one trefoil known is knotted, whatever the other is.
    knot = drawn_knot(np.random.default_rng(5), "granny", swirls=0)
    found = find_crossings([knot.curve], ["a"])
    known = with_heights(found, [knot.curve], [knot.heights], ["a"])
    answers = {
        is_knotted([c._replace(above=None) if n == k else c for n, c in enumerate(known)], "a")
        for k in range(len(known))
    }
    assert answers == {True}
    assert is_knotted(found, "a") is None  # all unknown


U_LEFT = [[-50, -10, 0], [0, -10, 0], [15, 0, 0], [0, 10, 0], [-50, 10, 0]]
U_RIGHT = [[60, -9, 1], [10, -9, 1], [-5, 0, 0.5], [10, 9, -1], [60, 9, -1]]


def test_ropes_that_hook_each_other():
    clasp = seen(U_LEFT, U_RIGHT)
    assert len(clasp) == 2
    assert are_hooked(clasp, "a", "b") is are_hooked(clasp, "b", "a") is True
    # Both strands of one above those of the other.
    flat = [[u, v, 5] for u, v, _ in U_RIGHT]
    assert lifts_off(seen(U_LEFT, flat), "b", "a") is True
    assert lifts_off(seen(U_LEFT, flat), "a", "b") is True  # it is drawn from under both strands
    assert are_hooked(seen(U_LEFT, flat), "a", "b") is False


def test_lifting_agrees_with_linking_in_space():
    rng = np.random.default_rng(2)
    t = np.linspace(0, 1, 120)
    answers, by_polynomial = [], 0
    for _ in range(60):
        count, ropes = int(rng.integers(3, 6)), []
        for _ in range(2):
            rope = np.zeros((120, 3))
            for k in range(1, count + 1):
                size, phase = rng.normal(0, 60 / k**0.7, (1, 3)), rng.uniform(0, 6, (1, 3))
                rope += size * np.cos(k * np.pi * 1.5 * t[:, None] + phase)
            ropes.append(rope)
        crossings = seen(*ropes)
        answer = lifts_off(crossings, "a", "b")
        answers.append(answer)
        loops = [closed_above(ropes[0]), closed_above(ropes[1] * [1, 1, -1]) * [1, 1, -1]]
        found = crossings_in_space(loops, closed=True)
        linking = sum(c.sign for c in found if c.over[0] != c.under[0]) // 2
        if linking != 0 or determinant(loops) != 0:
            assert answer is False
        by_polynomial += answer is False and linking == 0
        both = Diagram.of(crossings, ("a", "b"), (ABOVE, BELOW))
        link = with_arc(with_arc(both, 0), 1)
        if link.count <= 18:
            assert jones_polynomial(link) == jones_polynomial(with_arc(with_arc(reduced(both), 0), 1))
    assert min(answers.count(True), answers.count(False)) >= 10
    assert answers.count(None) <= 2
    assert by_polynomial >= 1
