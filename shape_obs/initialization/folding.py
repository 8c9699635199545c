"""Contour folding: the centreline of a simple ribbon from its outline.

The outline becomes 256 equidistant complex points z. The axis of best self-overlap is the k that maximises
Re sum z[i] conj(z[k - i]), and half of it is a tip; the strongest bends are tried as tips too. The centreline is the
mean of both sides between the two tips whose sides lie closest together.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter1d

from shape_obs.geometry.polyline import arc_length

Array = npt.NDArray[np.float64]
Places = npt.NDArray[Any]  # complex numbers, u + v i

_N: Final = 256  # places around the outline
_SIDE_POINTS: Final = 96  # along its sides, and of those the ones by which tips are chosen
_SIDE_PROBES: Final = 32
_SHARP_BENDS: Final = 8  # bends that are tried as tips
_NEAR: Final = 3  # places


def fold_outline(outline: Array, width: float) -> Array:
    """Return the centreline of a ribbon, by folding its outline about its tips.

    Args:
        outline: ``(P, 2)`` closed outline, pixels.
        width: The ribbon's width, pixels.

    Returns:
        ``(96, 2)`` centreline from tip to tip, equidistant along the outline, in no particular direction.
    """
    closed = np.concatenate([outline, outline[:1]])
    arc = arc_length(closed)
    perimeter = float(arc[-1])
    if perimeter == 0:  # a single pixel
        return np.repeat(outline[:1], _SIDE_POINTS, axis=0)
    traced, step = _complex(closed), perimeter / _N
    even = np.interp(np.arange(_N) * step, arc, traced)
    tip = _half_fold(even)
    tips = np.unique(np.array([tip, tip + _N / 2, *_sharp_bends(even, width / step)]) % _N)
    firsts, seconds = (tips[chosen, None] for chosen in np.triu_indices(len(tips), 1))
    left, right = (np.interp(side, np.arange(_N), even, period=_N) for side in _sides(firsts, seconds, _SIDE_PROBES))
    best = int(np.argmin(np.sum(np.abs(left - right) ** 2, axis=1)))
    sides = _sides(firsts[best], seconds[best], _SIDE_POINTS)
    middle = sum(np.interp(side % _N * step, arc, traced) for side in sides) / 2
    return np.stack([middle.real, middle.imag], axis=1)


def unexplained_share(outline: Array, curve: Array, reach: float) -> float:
    """Return the share of every other point of a ribbon's outline ``(P, 2)`` that lies far from a curve ``(S, 2)``.

    Far is more than ``reach`` and half the curve's widest step from all of its points.
    """
    points = _complex(curve)
    widest = np.abs(np.diff(points)).max(initial=0.0)
    apart = np.abs(_complex(outline[::2])[:, None] - points).min(axis=1)
    return float(np.mean(apart > reach + widest / 2))


def _complex(points: Array) -> Places:
    return points[:, 0] + 1j * points[:, 1]


def _sides(first: Array, second: Array, count: int) -> tuple[Array, Array]:
    """Return ``count`` places from one tip to another, either way around the outline."""
    share = np.linspace(0, 1, count)
    return first + share * (second - first), first - share * (_N - second + first)


def _half_fold(even: Places) -> float:
    """Return half of the best k of the fold i -> k - i, one of its fixed points. Every other place finds its region."""
    near = 2 * int(np.argmax(_overlap(even[::2]))) + np.arange(-_NEAR, _NEAR + 1)
    return float(near[np.argmax(_overlap(even)[near % _N])] % _N) / 2


def _overlap(even: Places) -> Array:
    """Return how much an outline overlaps itself for every fold i -> k - i."""
    centred = even - even.mean()
    return np.fft.ifft(np.fft.fft(centred) * np.fft.fft(centred.conj())).real


def _sharp_bends(even: Places, width: float) -> list[int]:
    """Return the places where the outline turns most within a ribbon's width, which is in steps."""
    reach = int(np.clip(np.rint(width), 1, _N // 4))
    turn = np.angle((np.roll(even, -reach) - even) * (even - np.roll(even, reach)).conj())
    within = np.abs(uniform_filter1d(turn, 2 * reach + 1, mode="wrap"))
    bends: list[int] = []
    while len(bends) < _SHARP_BENDS and within.max() > 0:
        bends.append(int(np.argmax(within)))
        within[np.arange(bends[-1] - 2 * reach, bends[-1] + 2 * reach + 1) % _N] = 0.0
    return bends
