"""Contour folding: the centreline of a simple ribbon from its outline.

The outline becomes 256 complex points z, which are equidistant along the axis: around a bend they are sparser on the
outer side than on the inner one. The axis of best self-overlap is the k that maximises
Re sum z[i] conj(z[k - i]), and half of it is a tip; the strongest bends are tried as tips too. The centreline is the
mean of both sides between the two tips whose sides lie closest together.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.polyline import arc_length

Array = npt.NDArray[np.float64]
Places = npt.NDArray[Any]  # complex numbers, u + v i

AXIS_POINTS: Final = 96  # of an axis from tip to tip, at least
_N: Final = 256  # places around the outline, a power of 2 for the Fourier transform
_SIDE_PROBES: Final = AXIS_POINTS // 3  # points of both sides by which tips are chosen: as good as all, and quicker
_SHARP_BENDS: Final = 8  # bends that are tried as tips: 45 pairs with the fold's own two
_STEP: Final = 0.25  # widths from point to point of an outline, whose direction is taken over a width to both sides
_LEAST: Final = 2 / np.pi  # length of the axis over that of the outline: a round tip, half a circle over its diameter


def fold_outline(outline: Array, width: float) -> Array:
    """Return the centreline of a ribbon, by folding its outline about its tips.

    Args:
        outline: ``(P, 2)`` closed outline, pixels.
        width: The ribbon's width, pixels.

    Returns:
        ``(96, 2)`` centreline from tip to tip, about equidistant, in no particular direction.
    """
    closed = np.concatenate([outline, outline[:1]])
    arc = arc_length(closed)
    if arc[-1] == 0:  # a single pixel
        return np.repeat(outline[:1], AXIS_POINTS, axis=0)
    traced, arc = _along_axis(_complex(closed), arc, width)
    step = float(arc[-1]) / _N
    even = np.interp(np.arange(_N) * step, arc, traced)
    tip = _half_fold(even)
    tips = np.unique(np.array([tip, tip + _N / 2, *sharp_bends(even, width / step)]) % _N)
    first, second = (tips[chosen] for chosen in closest_sides(even, tips))
    share = np.linspace(0, 1, AXIS_POINTS)
    sides = first + share * (second - first), first - share * (_N - second + first)
    middle = sum(np.interp(side % _N * step, arc, traced) for side in sides) / 2
    return np.stack([middle.real, middle.imag], axis=1)


def _along_axis(traced: Places, arc: Array, width: float) -> tuple[Places, Array]:
    """Resample a ribbon's outline, and measure the ribbon's axis along it: ``(P + 1,)`` places, ``(P + 1,)`` lengths.

    Around a bend the outer side is longer than the axis by half a width times the angle, and the inner one is shorter;
    measured along the axis, both sides reach a bend at the same length.

    Args:
        traced: The outline, the first place repeated.
        arc: Its arc length.
        width: The ribbon's width.
    """
    count = max(int(arc[-1] / max(_STEP * width, 1.0)), _N)
    at = np.linspace(0.0, arc[-1], count + 1)
    places = np.interp(at, arc, traced)
    reach = min(max(round(width / at[1]), 1), count // 4)
    chord = np.roll(places[:-1], -reach) - np.roll(places[:-1], reach)
    turn = np.angle(np.roll(chord, -1) * chord.conj())
    outer = turn * np.sign(turn.sum())  # the way around as a whole turns outwards
    ahead = np.maximum(at[1] - width / 2 * outer, _LEAST * at[1])
    return places, np.concatenate([[0.0], np.cumsum(ahead)])


@compiled("(f8[:,::1], f8[:,::1], f8)")
def unexplained_share(outline: Array, curve: Array, reach: float) -> float:
    """Return the share of every other point of a ribbon's outline ``(P, 2)`` that lies far from a curve ``(S, 2)``.

    Far is more than ``reach`` and half the curve's widest step from all of its points.
    """
    widest = 0.0
    for s in range(1, len(curve)):
        widest = max(widest, math.hypot(curve[s, 0] - curve[s - 1, 0], curve[s, 1] - curve[s - 1, 1]))
    square, far, near = (reach + widest / 2) ** 2, 0, 0
    for p in range(0, len(outline), 2):
        for s in range(len(curve)):
            k = (near + s) % len(curve)  # the next place on an outline is near what the last one was near to
            if (curve[k, 0] - outline[p, 0]) ** 2 + (curve[k, 1] - outline[p, 1]) ** 2 <= square:
                near = k
                break
        else:
            far += 1
    return far / ((len(outline) + 1) // 2)


def _complex(points: Array) -> Places:
    return points[:, 0] + 1j * points[:, 1]


@compiled("(c16[::1], f8[::1])")
def closest_sides(even: Places, tips: Array) -> tuple[int, int]:
    """Return the two of some tips between which both sides of an even outline lie closest together."""
    best, least = (0, 1), np.inf
    for i in range(len(tips)):
        for j in range(i + 1, len(tips)):
            apart = 0.0
            for s in range(_SIDE_PROBES):
                share = s / (_SIDE_PROBES - 1)
                left = _place(even, tips[i] + share * (tips[j] - tips[i]))
                right = _place(even, tips[i] - share * (_N - tips[j] + tips[i]))
                apart += (left.real - right.real) ** 2 + (left.imag - right.imag) ** 2
            if apart < least:
                best, least = (i, j), apart
    return best


@compiled
def _place(even: Places, at: float) -> complex:
    """Return the point of an even outline at a fraction of a step."""
    at %= _N
    before = int(at)
    return even[before] + (at - before) * (even[(before + 1) % _N] - even[before])


def _half_fold(even: Places) -> float:
    """Return half of the k whose fold i -> k - i of an outline overlaps itself best: one of its fixed points."""
    centred = even - even.mean()
    overlap = np.fft.ifft(np.fft.fft(centred) * np.fft.fft(centred.conj())).real
    return int(np.argmax(overlap)) / 2


@compiled("(c16[::1], f8)")
def sharp_bends(even: Places, width: float) -> Array:
    """Return the places where an even outline turns most within a ribbon's width, which is in steps."""
    reach = min(max(int(np.rint(width)), 1), _N // 4)
    turn, within = np.empty(_N), np.empty(_N)
    for i in range(_N):
        turn[i] = np.angle((even[(i + reach) % _N] - even[i]) * np.conj(even[i] - even[i - reach]))
    total = 0.0
    for i in range(-reach, reach + 1):
        total += turn[i]
    for i in range(_N):
        within[i] = abs(total)
        total += turn[(i + reach + 1) % _N] - turn[i - reach]
    bends = np.empty(_SHARP_BENDS)
    for found in range(_SHARP_BENDS):
        peak = np.argmax(within)
        if within[peak] <= 0:
            return bends[:found]
        bends[found] = peak
        for i in range(peak - 2 * reach, peak + 2 * reach + 1):
            within[i % _N] = 0.0
    return bends
