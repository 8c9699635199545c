"""Points of the plane as complex numbers: one array instead of two columns, and turning is a product."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shape_obs.compiled.interface_outline import Array

Complex = npt.NDArray[np.complex128]


def plane(points: Array) -> Complex:
    """(...,2) points as (...) complex numbers u + iv, without a copy where they are contiguous."""
    return np.ascontiguousarray(points).view(np.complex128)[..., 0]


def points_of(places: Complex) -> Array:
    """And back: (...) -> (...,2)."""
    return places.view(np.float64).reshape(*places.shape, 2)


def lengths(steps: Array) -> Array:
    """(...,D) fresh differences -> (...) their lengths."""
    if steps.shape[-1] == 2:
        return np.abs(steps.view(np.complex128)[..., 0])
    return np.sqrt(np.einsum("...d,...d->...", steps, steps))
