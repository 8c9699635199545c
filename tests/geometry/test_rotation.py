"""The trace of the best rotation, in closed form, against the singular values of NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shape_obs.geometry import rotation

largest_trace: Any = rotation.largest_trace  # only compiled code calls it compiled
RATIOS = st.sampled_from([0.0, 1e-9, 1e-6, 1e-3, 0.1, 0.5, 0.999, 1.0])


@given(st.integers(0, 2**32 - 1), RATIOS, RATIOS, st.sampled_from([1e-6, 1.0, 1e4]), st.booleans())
def test_it_is_the_sum_of_the_singular_values_the_least_one_negative_if_the_matrix_mirrors(
    seed, second, third, scale, mirrored
):
    """Of points on a line two of them are 0, of points in a plane one; of a ball all are equal."""
    (left, _), (right, _) = (np.linalg.qr(each) for each in np.random.default_rng(seed).normal(size=(2, 3, 3)))
    covariance = scale * left @ np.diag([1.0, second, second * third]) @ right
    if mirrored:
        covariance[:, 0] *= -1
    first, middle, last = np.linalg.svd(covariance, compute_uv=False)
    expected = first + middle + (last if np.linalg.det(covariance) >= 0 else -last)
    # Of three equal values, one of them mirrored, the cubic has a triple root: half of the digits are lost.
    assert largest_trace.py_func(covariance) == pytest.approx(expected, abs=2e-5 * scale)


def test_nothing_has_no_trace():
    assert largest_trace.py_func(np.zeros((3, 3))) == 0
