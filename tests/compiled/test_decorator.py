"""The decorator: declared types, first calls, announcements, pickling."""

from __future__ import annotations

import numpy as np
import pytest

from shape_obs.compiled import compiled


@compiled
def scaled(x: float) -> float:
    return 3 * x


@compiled("(f8[::1], f8)", "(f8[:,::1], f8)")
def total(values: np.ndarray, share: float) -> float:
    """Return a sum."""
    whole = 0.0
    for value in values.flat:
        whole += scaled(value) * share
    return whole


@compiled("(f8[::1],)", reassociate=True)
def plain_sum(values: np.ndarray) -> float:
    whole = 0.0
    for value in values:
        whole += value
    return whole


def test_a_function_is_compiled_at_its_first_call_for_its_declared_types():
    assert total(np.ones(3), 0.5) == 4.5
    assert total(np.ones((2, 2)), share=1) == 12  # numbers are converted, arrays are not
    assert len(total.nopython_signatures) == 2  # pyright: ignore[reportFunctionMemberAccess]
    assert total.__doc__ == "Return a sum."
    assert plain_sum(np.arange(5.0)) == plain_sum.py_func(np.arange(5.0)) == 10  # pyright: ignore[reportFunctionMemberAccess]


@pytest.mark.parametrize(
    "values", [np.ones(2, np.float32), np.ones(4)[::2], np.ones((2, 2), order="F"), np.ones((2, 2, 2)), 3, None]
)
def test_arrays_of_another_type_or_layout_raise_type_error(values):
    with pytest.raises(TypeError, match="No matching definition"):
        total(values, 1.0)


def test_a_function_without_signature_is_not_for_python():
    with pytest.raises(TypeError, match="give it a signature"):
        scaled(2.0)
    assert scaled.py_func(2.0) == 6  # pyright: ignore[reportFunctionMemberAccess]
