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
from shape_obs.geometry.polyline import arc_length, closed, even_around, interpolate
from shape_obs.geometry.rotation import largest_trace, moved_onto, spread_of

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_STEPS: Final = 8  # of the search for where the known outline is
_LEAST_NODES: Final = 64  # at which outlines are compared
_SAMPLES: Final = 64  # of a visible piece, that are compared with the known outline
_STARTS: Final = 128  # at which the piece may begin, before these are refined
_FINER: Final = 4  # times: how much closer the places are that are tried next, to either side of the best one


@compiled
def hidden_pieces(
    points: Array, arc: Array, nodes: Array, known: Array, expected: Array, model: Any
) -> tuple[Mask, Array]:
    """Return where an outline is not the object's own, ``(P,)``, and the known outline where it lies now, ``(L, 2)``.

    Args:
        points: ``(P, 2)`` pixels, the outline, clockwise as seen.
        arc: ``(P + 1,)`` its arc length, the last entry the whole.
        nodes: ``(K, 2)`` pixels, equally spaced around it from where it begins if all of it is the object's own.
        known: ``(K, 2)`` pixels, equally spaced around the outline as it was, wherever it lay.
        expected: ``(K, 2)`` pixels, the same nodes where they are expected.
        model: The constants, one ``RingModel``.
    """
    cut, reach = np.zeros(len(points), np.bool_), int(model.turn_within)
    if not may_be_hidden(nodes, known, model):
        return cut, known
    count, around = max(len(known), _LEAST_NODES), closed(points)
    at = np.arange(count, dtype=np.float64) * (len(known) / count)
    aligned = closed(moved_onto(known, known, expected, np.ones(len(known)), True))
    aligned = interpolate(aligned, np.arange(len(aligned), dtype=np.float64), at)
    aligned = _moved_along(around, aligned, model)
    places = even_around(around, arc, 0.0, count)
    at, far, inside = nearest_places(closed(aligned), places)
    off = inside & (far > model.inside)
    if not off.any() or off.all():
        return cut, aligned
    before, more = turns_around(aligned, model.turn_reach), turns_around(places, model.turn_reach)
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
        if min(more[first % count], more[last % count]) > model.cut_turn:  # else the object has changed its form
            first, last = min(first, begin), max(last, end)
            way = (last - first) % count / count * arc[-1]
            for p in range(len(points)):
                cut[p] |= (arc[p] - first / count * arc[-1]) % arc[-1] <= way
    return cut, aligned


@compiled
def may_be_hidden(nodes: Array, known: Array, model: Any) -> bool:
    """Return whether an outline ``(K, 2)`` leaves the known one, and turns almost as it does where something hides it.

    Args:
        nodes: Equally spaced.
        known: The same as they were, wherever they lay.
        model: The constants, one ``RingModel``.
    """
    count, far, reach = len(nodes), 0.0, int(model.turn_within)
    aligned = moved_onto(known, known, nodes, np.ones(count), True)
    for k in range(count):
        far = max(far, math.hypot(nodes[k, 0] - aligned[k, 0], nodes[k, 1] - aligned[k, 1]))
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
def _moved_along(line: Array, points: Array, model: Any) -> Array:
    """Return points ``(L, 2)`` turned, scaled and shifted so that most of them are on a closed line ``(P + 1, 2)``.

    Each step moves them towards the nearest places on the line (P. J. Besl, N. D. McKay, "A Method for Registration of
    3-D Shapes", 1992), weighted so that those that are far off count for little (D. Geman, D. E. McClure, 1987).

    Args:
        line: Clockwise as seen, the last point as the first.
        points: Where they were.
        model: The constants, one ``RingModel``.
    """
    weight, target = np.empty(len(points)), np.empty((len(points), 2))
    for _ in range(_STEPS):
        place, far, _ = nearest_places(line, points)
        limit = max(model.outlier * np.median(far), model.form_noise)
        for k in range(len(points)):
            i = int(place[k])
            for d in range(2):
                target[k, d] = line[i, d] + (place[k] - i) * (line[i + 1, d] - line[i, d])
            weight[k] = 1 / (1 + (far[k] / limit) ** 2) ** 2
        points = moved_onto(points, points, target, weight, True)
    return points


@compiled
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


@compiled
def complete_outline(
    points: Array, space: Array, cut: Mask, known: Array, expected: Array, model: Any
) -> tuple[Array, int, float]:
    """Return a closed curve of which a part is hidden with that part put back.

    What is seen fits a piece of the known outline of the same length: of all such pieces, the one that it fits best
    after a rigid motion, and that is nearest to where it is expected.

    Args:
        points: ``(P, 2)`` pixels, the outline of what is seen.
        space: ``(P, 3)`` the same in metres; ``(0, 3)`` if its form is known in pixels.
        cut: ``(P,)`` whether it is not the object's own there.
        known: ``(K, D)`` equally spaced around the outline as it was, wherever it was.
        expected: ``(L, 2)`` pixels, equally spaced around it where it is expected.
        model: The constants, one ``RingModel``.

    Returns:
        ``(Q, D)`` the whole form, first what is seen of it, ``(0, D)`` if that is too little; how many points that are;
        the arc position at which the known outline begins.
    """
    form = space if len(space) > 0 else points
    nothing, (first, size), trimmed = (np.empty((0, form.shape[1])), 0, 0.0), _longest_own(cut), int(model.trimmed)
    first, size = first + trimmed, size - 2 * trimmed
    if size < 2:
        return nothing
    piece = np.empty((size, form.shape[1]))
    for p in range(size):
        for d in range(form.shape[1]):
            piece[p, d] = form[(first + p) % len(form), d]
    arc, ring = arc_length(piece), closed(known)
    along = arc_length(ring)
    length, whole = arc[-1], along[-1]
    if not model.min_seen * whole < length < whole:
        return nothing
    at, some, pixels = np.empty(_SAMPLES), np.empty((_SAMPLES, form.shape[1])), np.empty((_SAMPLES, 2))
    for n in range(_SAMPLES):
        p = int(np.rint(n * ((size - 1) / (_SAMPLES - 1))))
        at[n] = arc[p]
        for d in range(form.shape[1]):
            some[n, d] = piece[p, d]
        for d in range(2):
            pixels[n, d] = points[(first + p) % len(points), d]
    places, own, spread = closed(expected), _SAMPLES * spread_of(some), _SAMPLES * spread_of(pixels)
    step, begin, least = whole / _STARTS, 0.0, np.inf
    for k in range(_STARTS):
        off = _misfit(k * step, at, some, pixels, ring, along, places, own, spread, model)
        begin, least = (k * step, off) if off < least else (begin, least)
    for _ in range(2):
        middle = begin
        for k in range(-_FINER, _FINER + 1):
            start = middle + k / _FINER * step
            off = _misfit(start, at, some, pixels, ring, along, places, own, spread, model)
            begin, least = (start, off) if off < least else (begin, least)
        step /= _FINER
    steps = max(int(np.rint((whole - length) / (length / size))), 2)
    hidden = np.empty(steps + 1)  # from the last point that is seen to the first
    for k in range(steps + 1):
        hidden[k] = (begin + length + (whole - length) * k / steps) % whole
    for n in range(_SAMPLES):
        at[n] = (at[n] + begin) % whole
    pattern = interpolate(ring, along, at)
    back = moved_onto(interpolate(ring, along, hidden), pattern, some, np.ones(_SAMPLES), False)
    out = np.empty((size + steps - 1, form.shape[1]))
    for q in range(len(out)):
        for d in range(form.shape[1]):
            if q < size:
                out[q, d] = piece[q, d]
            else:
                share = (q - size + 1) / steps
                gap = (1 - share) * (piece[size - 1, d] - back[0, d]) + share * (piece[0, d] - back[steps, d])
                out[q, d] = back[q - size + 1, d] + gap
    return out, size, -begin


@compiled
def _longest_own(cut: Mask) -> tuple[int, int]:
    """Return the first point of the longest piece of an outline ``(P,)`` that is its own, and how many it has."""
    count, last = len(cut), 0
    while not cut[last]:
        last += 1
    first, size = last, 0
    for p in range(last + 1, last + count + 1):
        if cut[p % count]:
            first, size = (last + 1, p - last - 1) if p - last - 1 > size else (first, size)
            last = p
    return first % count, size


@compiled
def _misfit(
    begin: float, at: Array, some: Array, pixels: Array, ring: Array, along: Array, places: Array, own: float,
    spread: float, model: Any,
) -> float:  # fmt: skip
    """Return by how much what is seen misses the piece of the known outline from a place on, but for a constant.

    Args:
        begin: The place.
        at: ``(N,)`` arc positions of some of the points that are seen.
        some: ``(N, D)`` these points.
        pixels: ``(N, 2)`` the same in the image.
        ring: ``(K + 1, D)`` the known outline.
        along: ``(K + 1,)`` its arc length.
        places: ``(L + 1, 2)`` pixels, equally spaced around it where it is expected.
        own: Sum of the squares of the points about their mean.
        spread: The same in the image.
        model: The constants, one ``RingModel``.
    """
    count, size, whole, last, i = len(at), some.shape[1], along[-1], len(places) - 1, 0
    pattern, covariance, other, away = np.empty((size, count)), np.empty((size, size)), 0.0, 0.0
    for n in range(count):
        here = (at[n] + begin) % whole
        i = i if along[i] <= here else 0
        while along[i + 1] < here:
            i += 1
        share = (here - along[i]) / (along[i + 1] - along[i])
        for d in range(size):
            pattern[d, n] = ring[i, d] + share * (ring[i + 1, d] - ring[i, d])
        j = min(int(here / whole * last), last - 1)
        share = here / whole * last - j
        for d in range(2):
            away += (places[j, d] + share * (places[j + 1, d] - places[j, d]) - pixels[n, d]) ** 2
    for d in range(size):
        row = pattern[d] - pattern[d].mean()
        for e in range(size):
            covariance[d, e] = 0.0
            for n in range(count):
                covariance[d, e] += row[n] * some[n, e]
        for n in range(count):
            other += row[n] * row[n]
    return (other - 2 * largest_trace(covariance)) / own + model.place_cost * away / spread


@compiled
def sticks_out(hidden: Array, outline: Array, far: float) -> bool:
    """Return whether a hidden part ``(L, 2)`` is so far beyond the outline ``(P, 2)`` of what is seen, all in pixels.

    What only touches an object hides nothing of it: its outline is then its own everywhere.
    """
    _, off, inside = nearest_places(closed(outline), hidden)
    return bool(((off > far) & ~inside).any())
