"""Contour folding: the centreline of a ribbon from its outline, on NumPy.

A ribbon's outline runs down one side and back on the other. Read as complex numbers z[i], it lies nearest to itself
when folded about its tips: z[i] meets z[k-i]. One correlation finds the best k; sharp bends of the outline are tried as
tips too, because on spirals the two sides differ in length and an even fold slips.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from shape_obs.compiled.interface import OUTLINE_POINTS, SHARP_BENDS, SIDE_POINTS, SIDE_PROBES, Array
from shape_obs.compiled.numpy_curve import arc_length, interpolate
from shape_obs.compiled.numpy_map import best_matching_units

Complex = npt.NDArray[np.complex128]


def fold(outline: Array, width: float) -> Array:
    """See ``Kernels.fold``."""
    closed = np.concatenate([outline, outline[:1]])
    arc = arc_length(closed)
    perimeter = float(arc[-1])
    if perimeter == 0:  # a single pixel
        return np.repeat(outline[:1], SIDE_POINTS, axis=0)
    z = np.interp(np.arange(OUTLINE_POINTS) * (perimeter / OUTLINE_POINTS), arc, closed[:, 0] + 1j * closed[:, 1])
    half = _half_fold(z)
    bends = _sharp_bends(z, width * OUTLINE_POINTS / perimeter)
    tips = np.unique(np.array([half, half + OUTLINE_POINTS / 2, *bends]) % OUTLINE_POINTS)
    i, j = _pairs(len(tips))
    first, second = tips[i], tips[j]
    left, right = _sides(first[:, None], second[:, None], SIDE_PROBES)
    apart = _at(z, left) - _at(z, right)
    best = int(np.argmin(np.einsum("ts,ts->t", apart.real, apart.real) + np.einsum("ts,ts->t", apart.imag, apart.imag)))
    step = perimeter / OUTLINE_POINTS
    left, right = _sides(first[best], second[best], SIDE_POINTS)
    return (interpolate(closed, arc, left * step) + interpolate(closed, arc, right * step)) / 2


def unexplained(outline: Array, curve: Array, reach: float) -> float:
    """See ``Kernels.unexplained``."""
    step, some = curve[1:] - curve[:-1], outline[::2]
    reach += float(np.einsum("pd,pd->p", step, step).max()) ** 0.5 / 2
    away = some - curve[best_matching_units(some, curve)]
    return np.count_nonzero(np.einsum("pd,pd->p", away, away) > reach**2) / len(some)


def _half_fold(z: Complex) -> float:
    """Half of the best k of the fold i -> k - i: one of its fixed points."""
    z = z - z.mean()
    spectrum = np.fft.fft(z)
    mirrored = np.conj(np.concatenate([spectrum[:1], spectrum[:0:-1]]))  # the spectrum of the conjugate
    return int(np.argmax(np.fft.ifft(spectrum * mirrored).real)) / 2


def _sharp_bends(z: Complex, width: float) -> list[int]:
    """Where the outline turns most within a ribbon's width; ``width`` in outline steps."""
    reach = min(max(round(width), 1), OUTLINE_POINTS // 4)
    around = np.concatenate([z[-reach:], z, z[:reach]])
    ahead, behind = around[2 * reach :] - z, z - around[: -2 * reach]
    turn = np.angle(ahead * np.where(behind == 0, 1, behind).conj())
    total = np.cumsum(np.concatenate([[0.0], turn[-reach:], turn, turn[:reach]]))
    turn = np.abs(total[2 * reach + 1 :] - total[: -2 * reach - 1])
    peaks: list[int] = []
    for _ in range(SHARP_BENDS):
        peak = int(np.argmax(turn))
        if turn[peak] <= 0:
            break
        peaks.append(peak)
        turn[np.arange(peak - 2 * reach, peak + 2 * reach + 1) % OUTLINE_POINTS] = 0
    return peaks


def _sides(first: npt.ArrayLike, second: npt.ArrayLike, count: int) -> tuple[Array, Array]:
    """Places along both sides between two tips, each walked evenly from the first tip; in outline steps."""
    share, first, second = np.linspace(0, 1, count), np.asarray(first), np.asarray(second)
    forward = first + share * (second - first)
    return forward % OUTLINE_POINTS, (first - share * (OUTLINE_POINTS - second + first)) % OUTLINE_POINTS


def _at(z: Complex, place: Array) -> Complex:
    """The even outline at fractions of a step."""
    before = place.astype(np.intp)
    step = np.append(z[1:], z[0]) - z
    return z[before] + (place - before) * step[before]


@lru_cache(maxsize=16)
def _pairs(count: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Every two of so many, in order."""
    first, second = np.triu_indices(count, 1)
    return first, second
