"""Contour folding: the centreline of a simple ribbon from its outline.

The outline becomes 256 equidistant complex points z. The axis of best self-overlap is the k that maximises
Re sum z[i] conj(z[k - i]), and half of it is a tip; the strongest bends are tried as tips too. The centreline is the
mean of both sides between the two tips whose sides lie closest together.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.polyline import arc_length, interpolate

Array = npt.NDArray[np.float64]

_N: Final = 256  # places around the outline
_SIDE_POINTS: Final = 96  # along its sides, and of those the ones by which tips are chosen
_SIDE_PROBES: Final = 32
_SHARP_BENDS: Final = 8  # bends that are tried as tips
_NEAR: Final = 3  # places


@compiled
def fold_outline(outline: Array, width: float) -> Array:
    """Return the centreline of a ribbon, by folding its outline about its tips.

    Args:
        outline: ``(P, 2)`` closed outline, pixels.
        width: The ribbon's width, pixels.

    Returns:
        ``(96, 2)`` centreline from tip to tip, equidistant along the outline, in no particular direction.
    """
    closed = np.empty((len(outline) + 1, 2))
    closed[:-1], closed[-1] = outline, outline[0]
    arc = arc_length(closed)
    perimeter = arc[-1]
    if perimeter == 0:  # a single pixel
        return np.ones((_SIDE_POINTS, 1)) * outline[:1]
    even = interpolate(closed, arc, np.arange(_N) * (perimeter / _N))
    tips = np.empty(2 + _SHARP_BENDS)
    tips[0] = _half_fold(even)
    tips[1] = tips[0] + _N / 2
    tips = np.unique(tips[: _sharp_bends(even, width * _N / perimeter, tips, 2)] % _N)
    best, least = (0, 1), np.inf
    for i in range(len(tips)):
        for j in range(i + 1, len(tips)):
            apart = 0.0
            for s in range(_SIDE_PROBES):
                share = s / (_SIDE_PROBES - 1)
                x, y = _place(even, tips[i] + share * (tips[j] - tips[i]))
                u, v = _place(even, tips[i] - share * (_N - tips[j] + tips[i]))
                apart += (x - u) ** 2 + (y - v) ** 2
            if apart < least:
                best, least = (i, j), apart
    first, second, step = tips[best[0]], tips[best[1]], perimeter / _N
    left, right = np.empty(_SIDE_POINTS), np.empty(_SIDE_POINTS)
    for s in range(_SIDE_POINTS):
        share = s / (_SIDE_POINTS - 1)
        left[s] = (first + share * (second - first)) % _N * step
        right[s] = (first - share * (_N - second + first)) % _N * step
    return (interpolate(closed, arc, left) + interpolate(closed, arc, right)) / 2


@compiled
def unexplained_share(outline: Array, curve: Array, reach: float) -> float:
    """Return the share of every other point of a ribbon's outline ``(P, 2)`` that lies far from a curve ``(S, 2)``.

    Far is more than ``reach`` and half the curve's widest step from all of its points.
    """
    widest = 0.0
    for p in range(1, len(curve)):
        widest = max(widest, (curve[p, 0] - curve[p - 1, 0]) ** 2 + (curve[p, 1] - curve[p - 1, 1]) ** 2)
    square = (reach + np.sqrt(widest) / 2) ** 2
    far, near = 0, 0  # the next place on an outline is near what the last one was near to
    for m in range(0, len(outline), 2):
        x, y = outline[m, 0], outline[m, 1]
        if (curve[near, 0] - x) ** 2 + (curve[near, 1] - y) ** 2 <= square:
            continue
        far += 1
        for p in range(len(curve)):
            if (curve[p, 0] - x) ** 2 + (curve[p, 1] - y) ** 2 <= square:
                near, far = p, far - 1
                break
    return far / ((len(outline) + 1) // 2)


@compiled
def _half_fold(even: Array) -> float:
    """Return half of the best k of the fold i -> k - i, one of its fixed points. Every other place finds its region."""
    x, y = even[:, 0] - even[:, 0].mean(), even[:, 1] - even[:, 1].mean()
    back_x, back_y = np.empty(2 * _N), np.empty(2 * _N)
    for i in range(2 * _N):
        back_x[i], back_y[i] = x[-i % _N], y[-i % _N]
    half_x, half_y, half_back_x, half_back_y = x[::2].copy(), y[::2].copy(), back_x[::2].copy(), back_y[::2].copy()
    near, most = 0, -np.inf
    for k in range(_N // 2):
        overlap = _overlap(half_x, half_y, half_back_x, half_back_y, k)
        if overlap > most:
            near, most = 2 * k, overlap
    best, most = 0, -np.inf
    for k in range(near - _NEAR, near + _NEAR + 1):
        overlap = _overlap(x, y, back_x, back_y, k % _N)
        if overlap > most:
            best, most = k % _N, overlap
    return best / 2


@compiled(reassociate=True)
def _overlap(x: Array, y: Array, back_x: Array, back_y: Array, k: int) -> float:
    """Return how much an outline overlaps itself, folded i -> k - i; ``back`` is it twice around, backwards."""
    count, overlap = len(x), 0.0
    for i in range(count):
        overlap += x[i] * back_x[count - k + i] + y[i] * back_y[count - k + i]
    return overlap


@compiled
def _sharp_bends(even: Array, width: float, tips: Array, known: int) -> int:
    """Add the places where the outline turns most within a ribbon's width to the tips; return how many there are."""
    reach = min(max(int(np.rint(width)), 1), _N // 4)
    turn = np.empty(_N)
    for i in range(_N):
        ahead, before = (i + reach) % _N, (i - reach) % _N
        ax, ay = even[ahead, 0] - even[i, 0], even[ahead, 1] - even[i, 1]
        bx, by = even[i, 0] - even[before, 0], even[i, 1] - even[before, 1]
        if bx == 0 and by == 0:
            bx = 1.0
        turn[i] = np.arctan2(ay * bx - ax * by, ax * bx + ay * by)
    total, within = 0.0, np.empty(_N)
    for i in range(-reach, reach + 1):
        total += turn[i % _N]
    for i in range(_N):
        within[i] = abs(total)
        total += turn[(i + reach + 1) % _N] - turn[(i - reach) % _N]
    for _ in range(_SHARP_BENDS):
        peak = np.argmax(within)
        if within[peak] <= 0:
            break
        tips[known] = peak
        known += 1
        for i in range(peak - 2 * reach, peak + 2 * reach + 1):
            within[i % _N] = 0.0
    return known


@compiled
def _place(even: Array, at: float) -> tuple[float, float]:
    """Return the point of the even outline at a fraction of a step."""
    at %= _N
    before = int(at)
    after, share = (before + 1) % _N, at - before
    x = even[before, 0] + share * (even[after, 0] - even[before, 0])
    return x, even[before, 1] + share * (even[after, 1] - even[before, 1])
