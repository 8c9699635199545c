"""Gauss codes and the crossing matrix of crossings that are written down."""

from __future__ import annotations

import numpy as np

from shape_obs.geometry.crossings import Crossing, crossing_matrix, format_code, gauss_codes

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
