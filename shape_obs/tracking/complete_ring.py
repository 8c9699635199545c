"""Find what hides a part of a closed outline, and put that part back.

Without depth, what hides a part is seen by its own outline: it lies within the known one, and where the two meet the
outline turns as it did not before. An object that changes its form by itself has no such turns.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.polyline import arc_length, closed, even_around, interpolate
from shape_obs.geometry.rotation import fit, laid_flat, similarity
from shape_obs.tracking.model import Model, RingConstants, RingModel  # noqa: F401 - the second in a signature

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_STEPS: Final = 8  # of the search for where the known outline is
_LEAST_NODES: Final = 64  # at which outlines are compared
_FEWEST: Final = 8  # points of a visible piece
_SAMPLES: Final = 64  # of a visible piece, that are compared with the known outline
_STARTS: Final = 128  # at which the piece may begin, before these are refined


@compiled("(f8[:,::1], f8[::1], f8[:,::1], f8[:,::1], f8[:,::1], RingConstants[::1])")
def hidden_pieces(
    points: Array, arc: Array, nodes: Array, known: Array, expected: Array, model: Model
) -> tuple[Mask, Array]:
    """Return where an outline is not the object's own, ``(P,)``, and the known outline where it lies now, ``(L, 2)``.

    Args:
        points: ``(P, 2)`` pixels, the outline, clockwise as seen.
        arc: ``(P + 1,)`` its arc length, the last entry the whole.
        nodes: ``(K, 2)`` pixels, equally spaced around it from where it begins if all of it is the object's own.
        known: ``(K, 2)`` pixels, equally spaced around the outline as it was, wherever it lay.
        expected: ``(K, 2)`` pixels, the same nodes where they are expected.
        model: ``(1,)`` the constants.
    """
    constants, reach = model[0], int(model[0].turn_within)
    cut, everywhere = np.zeros(len(points), np.bool_), np.ones(len(known), np.bool_)
    if not may_be_hidden(nodes, known, constants):
        return cut, laid_flat(known, similarity(known, nodes, everywhere))
    count, around = max(len(known), _LEAST_NODES), closed(points)
    at = np.arange(count, dtype=np.float64) * (len(known) / count)
    laid = closed(laid_flat(known, similarity(known, expected, everywhere)))
    laid = interpolate(laid, np.arange(len(laid), dtype=np.float64), at)
    laid = laid_along(around, laid, constants.outlier, constants.form_noise)
    places = even_around(around, arc, 0.0, count)
    at, far, inside = nearest_places(closed(laid), places)
    off = inside & (far > constants.inside)
    if not off.any() or off.all():
        return cut, laid
    before, more = turns_around(laid, constants.turn_reach), turns_around(places, constants.turn_reach)
    for k in range(count):
        i = int(at[k])
        more[k] -= before[i] + (at[k] - i) * (before[(i + 1) % count] - before[i])
    for begin in range(count):
        if not off[begin] or off[begin - 1]:
            continue
        end = begin
        while off[(end + 1) % count]:
            end += 1
        first, last = begin, end
        for step in range(-1, reach + 1):
            first = begin - step if more[(begin - step) % count] > more[first % count] else first
            last = end + step if more[(end + step) % count] > more[last % count] else last
        if min(more[first % count], more[last % count]) > constants.cut_turn:  # else the object has changed its form
            first, last = min(first, begin), max(last, end)
            way = (last - first) % count / count * arc[-1]
            for p in range(len(points)):
                cut[p] |= (arc[p] - first / count * arc[-1]) % arc[-1] <= way
    return cut, laid


@compiled
def may_be_hidden(nodes: Array, known: Array, model: Any) -> bool:
    """Return whether an outline ``(K, 2)`` leaves the known one, and turns almost as it does where something hides it.

    Args:
        nodes: Equally spaced.
        known: The same as they were, wherever they lay.
        model: The constants, one ``RingModel``.
    """
    count, far, reach = len(nodes), 0.0, int(model.turn_within)
    laid = laid_flat(known, similarity(known, nodes, np.ones(count, np.bool_)))
    for k in range(count):
        far = max(far, math.hypot(nodes[k, 0] - laid[k, 0], nodes[k, 1] - laid[k, 1]))
    if far < model.inside:
        return False
    now, then = turns_around(nodes, model.turn_reach), turns_around(known, model.turn_reach)
    for k in range(count):
        nearby = -np.inf
        for step in range(-reach, reach + 1):
            nearby = max(nearby, then[(k + step) % count])
        if now[k] - nearby > model.may_cut * model.cut_turn:
            return True
    return False


@compiled
def turns_around(nodes: Array, reach: float) -> Array:
    """Return ``(K,)`` radians by which a closed line ``(K, 2)`` turns about each node, clockwise as seen.

    A turn is measured over a share of the line to either side.
    """
    count, chord, out = len(nodes), round(reach * len(nodes)), np.empty(len(nodes))
    for k in range(count):
        after, before = (k + chord) % count, (k - chord) % count
        u, v = nodes[after, 0] - nodes[k, 0], nodes[after, 1] - nodes[k, 1]
        x, y = nodes[k, 0] - nodes[before, 0], nodes[k, 1] - nodes[before, 1]
        out[k] = math.atan2(x * v - y * u, x * u + y * v)
    return out


@compiled
def laid_along(line: Array, points: Array, outlier: float, noise: float) -> Array:
    """Return points ``(L, 2)`` turned, scaled and shifted so that most of them lie on a closed line ``(P + 1, 2)``.

    Each step moves them towards the nearest places on the line (P. J. Besl, N. D. McKay, "A Method for Registration of
    3-D Shapes", 1992), weighted so that those that lie far off count for little (D. Geman, D. E. McClure, 1987).

    Args:
        line: Clockwise as seen, the last point as the first.
        points: Where they were.
        outlier: Median distances: what is farther off counts for little.
        noise: Pixels: what is nearer does not.
    """
    laid, count = points.copy(), len(points)
    for _ in range(_STEPS):
        place, far, _ = nearest_places(line, laid)
        limit = max(outlier * np.median(far), noise)
        total = before_u = before_v = after_u = after_v = 0.0
        weight, target = np.empty(count), np.empty((count, 2))
        for k in range(count):
            i = int(place[k])
            share = place[k] - i
            for d in range(2):
                target[k, d] = line[i, d] + share * (line[i + 1, d] - line[i, d])
            weight[k] = 1 / (1 + (far[k] / limit) ** 2) ** 2
            total += weight[k]
            before_u += weight[k] * laid[k, 0]
            before_v += weight[k] * laid[k, 1]
            after_u += weight[k] * target[k, 0]
            after_v += weight[k] * target[k, 1]
        before_u, before_v, after_u, after_v = before_u / total, before_v / total, after_u / total, after_v / total
        cosine = sine = square = 0.0
        for k in range(count):
            x, y = laid[k, 0] - before_u, laid[k, 1] - before_v
            u, v = target[k, 0] - after_u, target[k, 1] - after_v
            cosine += weight[k] * (x * u + y * v)
            sine += weight[k] * (x * v - y * u)
            square += weight[k] * (x * x + y * y)
        cosine, sine = cosine / max(square, 1e-18), sine / max(square, 1e-18)
        for k in range(count):
            x, y = laid[k, 0] - before_u, laid[k, 1] - before_v
            laid[k, 0], laid[k, 1] = x * cosine - y * sine + after_u, x * sine + y * cosine + after_v
    return laid


@compiled("(f8[:,::1], f8[:,::1])")
def nearest_places(line: Array, points: Array) -> tuple[Array, Array, Mask]:
    """Return where a closed line is nearest to each point, how far that is, and whether the point is inside.

    Args:
        line: ``(P + 1, 2)``, clockwise as seen, the last point as the first.
        points: ``(N, 2)``.

    Returns:
        ``(N,)`` the place, as an index into the line that need not be whole; ``(N,)`` the distance; ``(N,)`` bool.
    """
    place, far, inside = np.empty(len(points)), np.empty(len(points)), np.empty(len(points), np.bool_)
    longest, best, pieces = 0.0, 0, len(line) - 1
    for i in range(pieces):
        longest = max(longest, math.hypot(line[i + 1, 0] - line[i, 0], line[i + 1, 1] - line[i, 1]))
    for n in range(len(points)):
        # The piece that was nearest to the point before is near this one: most others are farther away by many pieces.
        i, least, share, reach = best, np.inf, 0.0, np.inf
        for visit in range(pieces + 1):
            u, v = points[n, 0] - line[i, 0], points[n, 1] - line[i, 1]
            off = math.sqrt(u * u + v * v)
            if off > reach:
                i += max(int((off - reach) / longest), 1)
            else:
                x, y = line[i + 1, 0] - line[i, 0], line[i + 1, 1] - line[i, 1]
                along = min(max((u * x + v * y) / max(x * x + y * y, 1e-300), 0.0), 1.0)
                square = (u - along * x) ** 2 + (v - along * y) ** 2
                if square < least:
                    least, best, share = square, i, along
                    reach = math.sqrt(least) + longest
                i = i + 1 if visit > 0 else 0
            if i >= pieces:
                break
        place[n], far[n] = best + min(share, 1 - 1e-9), math.sqrt(least)
        x, y = line[best + 1, 0] - line[best, 0], line[best + 1, 1] - line[best, 1]
        inside[n] = x * (points[n, 1] - line[best, 1]) - y * (points[n, 0] - line[best, 0]) > 0
    return place, far, inside


def complete_outline(
    curve: FittedCurve, space: FittedCurve, cut: Mask, known: Array, expected: Array, model: RingModel
) -> tuple[FittedCurve, float] | None:
    """Return a closed curve of which a part is hidden with that part put back; None if too little is seen.

    What is seen lies over a piece of the known outline of the same length: of all such pieces, over the one that it
    fits best after a rigid motion, and that lies nearest to where it is expected.

    Args:
        curve: ``(P, 2)`` pixels, the outline of what is seen.
        space: ``(P, D)`` the same in metres, or in pixels.
        cut: ``(P,)`` whether it is not the object's own there.
        known: ``(K, D)`` equally spaced around the outline as it was, wherever it lay.
        expected: ``(L, 2)`` pixels, equally spaced around it where it is expected.
        model: The constants.

    Returns:
        The whole curve in the unit of ``space``, and the arc position at which the known outline begins.
    """
    ring = _closed(known)
    knots, count, trimmed = arc_length(ring), len(cut), int(model.trimmed)
    whole = knots[-1]
    over = np.flatnonzero(cut)
    free = np.diff(np.append(over, over[0] + count))
    index = (over[int(np.argmax(free))] + np.arange(1, int(free.max()))) % count  # the longest piece that is its own
    index = index[trimmed : len(index) - trimmed]
    if len(index) < _FEWEST:
        return None
    seen, pixels = space.points[index], curve.points[index]
    arc = arc_length(np.ascontiguousarray(seen))
    if not model.min_seen * whole < arc[-1] < whole:
        return None
    some = np.linspace(0, len(index) - 1, _SAMPLES).round().astype(int)
    around = np.linspace(0, whole, len(expected) + 1)

    def misfit(begin: Array) -> Array:
        at = (arc[some] + begin[:, None]) % whole
        pattern = np.stack([np.interp(at, knots, column) for column in ring.T], axis=-1)
        place = np.stack([np.interp(at, around, np.append(column, column[0])) for column in expected.T], axis=-1)
        before = pattern - pattern.mean(axis=1, keepdims=True)
        after = seen[some] - seen[some].mean(axis=0)
        product = np.swapaxes(before, 1, 2) @ after
        values = np.linalg.svd(product, compute_uv=False)
        values[:, -1] *= np.sign(np.linalg.det(product))
        own = (after**2).sum()
        shape = (own + (before**2).sum(axis=(1, 2)) - 2 * values.sum(axis=1)) / own
        away = ((place - pixels[some]) ** 2).sum(axis=(1, 2)) / ((pixels[some] - pixels[some].mean(axis=0)) ** 2).sum()
        return shape + model.place_cost * away

    begin, step, best = np.arange(_STARTS) * (whole / _STARTS), whole / _STARTS, 0.0
    for _ in range(3):
        best = begin[int(np.argmin(misfit(begin)))]
        begin, step = best + step * np.linspace(-1, 1, 9), step / 4
    at = (arc[some] + best) % whole
    pattern = np.stack([np.interp(at, knots, column) for column in ring.T], axis=-1)
    steps = max(round((whole - arc[-1]) / (arc[-1] / len(index))), 2)
    rest = arc[-1] + (whole - arc[-1]) * np.arange(1, steps) / steps
    ends = np.concatenate([[arc[-1], whole], rest])
    hidden = np.stack([np.interp((ends + best) % whole, knots, column) for column in ring.T], axis=-1)
    laid = fit(pattern, seen[some]).apply(hidden)
    share = (np.arange(1, steps) / steps)[:, None]
    laid = laid[2:] + (1 - share) * (seen[-1] - laid[0]) + share * (seen[0] - laid[1])
    points = np.concatenate([seen, laid])
    flags = np.arange(len(points)) >= len(seen)
    return FittedCurve.through(points, flags, True), float(-best)


def sticks_out(hidden: Array, outline: Array, far: float) -> bool:
    """Return whether a hidden part ``(L, 2)`` lies so far beyond the outline ``(P, 2)`` of what is seen, all in pixels.

    What only touches an object hides nothing of it: its outline is then its own everywhere.
    """
    _, off, inside = nearest_places(_closed(outline), np.ascontiguousarray(hidden))
    return bool((off > far)[~inside].any())


def _closed(points: Array) -> Array:
    return np.ascontiguousarray(np.concatenate([points, points[:1]]))
