"""Crossings of polylines against exact arithmetic, at vertices and tips; the codes of several ropes."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from shape_obs.geometry.crossings import Crossing, crossing_matrix, format_code, gauss_codes
from shape_obs.geometry.intersections import find_crossings

SEEDS = st.integers(0, 2**32 - 1)


def brute_force(curves):
    """Return the crossings of pieces that are no neighbours, with exact fractions, and where on the curves they are.

    Each is (curve, piece, curve, piece, handedness); the places are in pixels along both curves.
    """
    arcs = [np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))]) for line in curves]
    pieces = [
        (k, p, [[Fraction(float(x)) for x in point] for point in line[p : p + 2]])
        for k, line in enumerate(curves)
        for p in range(len(line) - 1)
    ]
    found = {}
    for n, (k, p, (a, b)) in enumerate(pieces):
        for m, q, (c, d) in pieces[n + 1 :]:
            if k == m and q <= p + 1:
                continue

            def side(one, other, point):
                return (other[0] - one[0]) * (point[1] - one[1]) - (other[1] - one[1]) * (point[0] - one[0])

            if side(a, b, c) * side(a, b, d) < 0 and side(c, d, a) * side(c, d, b) < 0:
                first = float(side(c, d, a) / (side(c, d, a) - side(c, d, b)))
                second = float(side(a, b, c) / (side(a, b, c) - side(a, b, d)))
                places = tuple(
                    arcs[i][r] + on * (arcs[i][r + 1] - arcs[i][r]) for i, r, on in ((k, p, first), (m, q, second))
                )
                found[k, p, m, q, 1 if side(a, b, d) > 0 else -1] = places
    return found


def touches(crossing, places, every, curves):
    """Tell whether a crossing lies at a tip or cancels with another, within twice the distance that still touches."""
    points = np.concatenate(curves)
    near = 2e-5 * np.abs(points - points[0]).max()
    lengths = [np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in curves]
    if any(min(at, lengths[k] - at) < near for k, at in zip(crossing[0:4:2], places, strict=True)):
        return True
    return any(
        crossing[0:4:2] == other[0:4:2] and crossing[4] != other[4] and np.abs(np.subtract(places, there)).max() < near
        for other, there in every.items()
    )


def piece(curve, share):
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    return int(np.searchsorted(arc, share * arc[-1])) - 1


@given(SEEDS, st.lists(st.integers(0, 24), min_size=0, max_size=4), st.booleans())
@example(135, [21], True)  # a tip 0.0007 pixels behind a strand
@example(87, [34], False)  # a vertex as near
def test_all_crossings_are_found(seed, sizes, walking):
    rng = np.random.default_rng(seed)
    curves = [rng.normal(0, 30, (size, 2)) for size in sizes]
    if walking:  # short pieces, as along a rope
        curves = [np.cumsum(curve, axis=0) for curve in curves]
    found = find_crossings(curves)
    got = []
    for crossing in found:
        (i, j), (first, second) = map(int, crossing.slots), crossing.arcs
        got.append((i, piece(curves[i], first), j, piece(curves[j], second), crossing.handedness))
        for k, share in ((i, first), (j, second)):
            p = piece(curves[k], share)
            arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curves[k], axis=0), axis=1))])
            on = (share * arc[-1] - arc[p]) / (arc[p + 1] - arc[p])
            there = curves[k][p] + on * (curves[k][p + 1] - curves[k][p])
            np.testing.assert_allclose(crossing.pixel, there, atol=1e-3)
    expected = brute_force(curves)
    assert len(got) == len(set(got))
    assert set(got) <= set(expected)
    assert all(touches(crossing, expected[crossing], expected, curves) for crossing in set(expected) - set(got))
    assert [(c.slots[0], c.arcs[0]) for c in found] == sorted((c.slots[0], c.arcs[0]) for c in found)


LINE = [[0.0, 0], [10, 0]]


@pytest.mark.parametrize(
    ("other", "count"),
    [
        ([[5, -5], [5, 0], [5, 5]], 1),  # its vertex on the line
        ([[2, 5], [2, 0], [3, 5]], 0),  # touches from one side
        ([[2, -5], [2, 0], [3, -5]], 0),
        ([[7, 3], [7, 0]], 0),  # its tip on the line
        ([[10, 3], [10, 0], [10, -3]], 0),  # over the tip of the line
        ([[2, 3], [3, 0], [5, 0], [6, -3]], 1),  # runs along it, then leaves on the other side
        ([[2, 3], [3, 0], [3, 0], [3, 0], [4, -3]], 1),  # a vertex three times
        ([[1, 1]], 0),
        ([[1, 1], [1, 1]], 0),
        (np.zeros((0, 2)), 0),
    ],
)
def test_touching_is_not_crossing(other, count):
    middle = [[0.0, 0], [5, 0], [10, 0]]
    for line in (LINE, middle):
        assert len(find_crossings([line, other])) == len(find_crossings([other, line])) == count


def test_a_vertex_on_a_vertex_is_found_once():
    cross = [[5.0, -5], [5, 0], [5, 5]], [[0.0, 0], [5, 0], [10, 0]]
    (found,) = find_crossings(cross, ["a", "b"])
    assert found.slots == ("a", "b")
    np.testing.assert_allclose(found.arcs, 0.5, atol=1e-6)
    np.testing.assert_allclose(found.pixel, (5, 0), atol=1e-6)
    assert found.above is None
    # ``a`` runs down; ``b`` runs to the right, which is from the right of ``a`` to its left.
    assert found.handedness == -1
    assert find_crossings(cross[::-1])[0].handedness == 1


def test_bad_curves_are_refused():
    assert find_crossings([]) == ()
    with pytest.raises(ValueError, match="'b' must be finite"):
        find_crossings([LINE, [[0.0, np.nan]]], ["a", "b"])
    with pytest.raises(ValueError, match="names: expected 1"):
        find_crossings([LINE], ["a", "b"])


@pytest.mark.parametrize(("past", "count"), [(1e-2, 1), (1e-5, 0)])
def test_a_strand_crosses_where_its_tip_lies_clearly_behind(past, count):
    """Strands that come within a hundred-thousandth of the extent of a tip touch."""
    assert len(find_crossings([[[0.0, 0], [100, 0]], [[50, 30], [50, -past]]])) == count


# ``a`` crosses itself, ``b`` and ``c``; ``b`` crosses ``c``.
SCENE = (
    Crossing(("a", "a"), (0.1, 0.5), (10.0, 20.0), 1, 1),
    Crossing(("a", "b"), (0.3, 0.9), (30.0, 20.0), 0, -1),
    Crossing(("a", "b"), (0.7, 0.2), (30.0, 50.0), None, 1),
    Crossing(("b", "c"), (0.4, 0.4), (60.0, 50.0), 1, -1),
    Crossing(("c", "a"), (0.6, 0.9), (90.0, 50.0), 0, 1),
)


def test_the_sign_is_that_of_the_right_hand():
    """The upper strand runs to the right, the lower one up: a counter-clockwise turn of a quarter."""
    up = Crossing(("a", "b"), (0.5, 0.5), (0.0, 0.0), 0, -1)  # (1, 0) and (0, -1) in pixels
    assert up.sign == 1
    assert up._replace(above=1).sign == -1
    assert up._replace(handedness=1).sign == -1
    assert up._replace(above=None).sign == 0


def test_the_codes_of_several_ropes():
    codes = gauss_codes(SCENE, ["a", "b", "c"])
    assert {name: format_code(code) for name, code in codes.items()} == {
        "a": "U1+ O2+ O1+ ?3? U4-",
        "b": "?3? U5- U2+",
        "c": "O5- O4-",
    }
    assert {name: format_code(code) for name, code in gauss_codes(SCENE, ["c", "b"]).items()} == {
        "c": "O1-",
        "b": "U1-",
    }


def test_the_matrix_counts_who_is_above():
    above, unknown = crossing_matrix(SCENE, ["a", "b", "c"])
    np.testing.assert_array_equal(above, [[1, 1, 0], [0, 0, 0], [1, 1, 0]])
    np.testing.assert_array_equal(unknown, [[0, 1, 0], [1, 0, 0], [0, 0, 0]])
    above, unknown = crossing_matrix(SCENE, ["c", "x"])
    assert not above.any()
    assert not unknown.any()
    assert crossing_matrix([], [])[0].shape == (0, 0)
