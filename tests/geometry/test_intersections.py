"""Crossings of polylines at vertices, at tips and where strands touch; the codes of several ropes."""

from __future__ import annotations

import numpy as np
import pytest

from shape_obs.geometry.crossings import Crossing, crossing_matrix, format_code, gauss_codes
from shape_obs.geometry.intersections import find_crossings

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
