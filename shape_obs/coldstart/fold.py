"""Contour folding: the centreline of a ribbon from its outline.

A ribbon's outline runs down one side and back on the other. Read as complex numbers z[i], it lies nearest to itself
when folded about its tips: z[i] meets z[k-i]. One FFT finds the best k; sharp bends of the outline are tried as tips
too, because on spirals the two sides differ in length and an even fold slips.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.curve import arc_length, interpolate

Array = npt.NDArray[np.float64]

_OUTLINE_POINTS: Final = 256
_SIDE_POINTS: Final = 96
_SHARP_BENDS: Final = 8


def fold(outline: Array, width: float) -> Array:
    """The centreline of a ribbon.

    Args:
        outline: (P,2) closed outline, pixels.
        width: The ribbon's width, pixels.

    Returns:
        (96,2) centreline from tip to tip, equidistant along the outline, in no particular direction.
    """
    closed = np.concatenate([outline, outline[:1]])
    arc = arc_length(closed)
    perimeter = float(arc[-1])
    if perimeter == 0:  # a single pixel
        return np.repeat(outline[:1], _SIDE_POINTS, axis=0)
    even = interpolate(closed, arc, np.arange(_OUTLINE_POINTS) * perimeter / _OUTLINE_POINTS)
    z = even[:, 0] + 1j * even[:, 1]
    tips = _fold_tips(z) + _sharp_bends(z, width * _OUTLINE_POINTS / perimeter)
    tip = np.unique(np.asarray(tips) % _OUTLINE_POINTS) * perimeter / _OUTLINE_POINTS
    first, second = np.triu_indices(len(tip), 1)
    left, right = _sides(closed, arc, tip[first], tip[second])
    separation = np.mean(np.sum((left - right) ** 2, axis=-1), axis=-1)
    best = int(np.argmin(separation))
    return (left[best] + right[best]) / 2


def _fold_tips(z: npt.NDArray[np.complex128]) -> list[float]:
    """The two fixed points of the best fold i -> k - i."""
    z = z - z.mean()
    overlap = np.fft.ifft(np.fft.fft(z) * np.fft.fft(z.conj())).real
    half = int(np.argmax(overlap)) / 2
    return [half, half + len(z) / 2]


def _sharp_bends(z: npt.NDArray[np.complex128], width: float) -> list[float]:
    """Where the outline turns most within a ribbon's width; ``width`` in outline steps."""
    reach = max(round(width), 1)
    turn = np.angle((np.roll(z, -reach) - z) / np.where(z == np.roll(z, reach), 1, z - np.roll(z, reach)))
    turn = np.abs(np.convolve(np.concatenate([turn[-reach:], turn, turn[:reach]]), np.ones(2 * reach + 1), "valid"))
    peaks: list[float] = []
    for _ in range(_SHARP_BENDS):
        peak = int(np.argmax(turn))
        if turn[peak] <= 0:
            break
        peaks.append(float(peak))
        turn[np.arange(peak - 2 * reach, peak + 2 * reach + 1) % len(turn)] = 0
    return peaks


def _sides(closed: Array, arc: Array, first: Array, second: Array) -> tuple[Array, Array]:
    """Both sides between pairs of tips at arc positions, each walked evenly from the first tip: (T,96,2) twice."""
    t = np.linspace(0, 1, _SIDE_POINTS)[None, :]
    perimeter = arc[-1]
    forward = first[:, None] + t * (second - first)[:, None]
    backward = first[:, None] - t * (perimeter - second + first)[:, None]
    shape = (len(first), _SIDE_POINTS, 2)
    left = interpolate(closed, arc, forward.ravel() % perimeter).reshape(shape)
    right = interpolate(closed, arc, backward.ravel() % perimeter).reshape(shape)
    return left, right
