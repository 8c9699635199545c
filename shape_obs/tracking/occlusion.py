"""Occlusion: find out which piece of a known rope a visible curve is.

A hand over one end shortens what is seen; it does not shorten the rope. The known length is kept, the visible piece
is put where it agrees with the prediction, and the hidden ends are carried along.
"""

from __future__ import annotations

from dataclasses import replace
from math import dist
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.curve import FittedCurve, TrackHints
from shape_obs.geometry.polyline import arc_length, interpolate
from shape_obs.tracking.occluders import LONG, is_hidden
from shape_obs.tracking.prediction import Prediction

Array = npt.NDArray[np.float64]

_PROBES: Final = 32  # points at which a visible piece is compared with the prediction
_OFFSETS: Final = 13  # places along the rope that are tried for it
# Of what is missing: when the best place leaves less than this at one end, all of it is hidden at the other. One hand
# hides one end; that both are hidden needs evidence.
_ONE_END: Final = 0.35
# The weight of where the piece was in the last frame against where it now agrees best: hands move slowly.
_INERTIA: Final = 0.05
_MOST: Final = 0.75  # of the length: a piece shorter than that lies elsewhere than the middle of the rope
_STRETCH: Final = 1.3  # a predicted piece is not laid into a gap that is this much wider or narrower
_PLACE: Final = 0.1  # the weight of where a rope is predicted against how it is bent
# Of the length, and in grains (pixels): what is missing below this is noise or a rope seen at a steeper angle. The
# points then run from visible tip to visible tip, and the known length gives way, slowly, or a hand that creeps in
# would shrink the rope.
_SLACK: Final = (0.015, 2.5)
_GIVING: Final = 0.003
_CLEAR: Final = 3.0  # how much nearer ends lie to their own places than to each other's
_ASKEW: Final = 0.6  # widths: of the visible piece next to a hidden end, which may follow the cut
_GAINING: Final = 0.01  # a chain that bulges in one frame does not make the rope longer for good


def match_chain(form: FittedCurve, prediction: Prediction, depth: npt.NDArray[Any] | None) -> FittedCurve:
    """Match a curve to the predicted rope: same direction, hidden ends put back, as long as the rope is known to be.

    A curve that is shorter than the known length is either the whole rope (seen at a steeper angle, or compressed) or
    a piece of it. The hypothesis that agrees better with the predicted points is taken, unless something is seen to
    lie over the rope where it goes out of sight. The hidden ends of a piece follow as predicted, moved along with the
    visible end, and are marked as interpolated.

    Args:
        form: ``(P, D)`` fitted to this frame, in any direction.
        prediction: Where the rope should be.
        depth: ``(H, W)`` the frame's depth if there is one and the curve is in pixels: it shows what lies over a place.
    """
    slack = max(_SLACK[0] * prediction.size, _SLACK[1] * prediction.resolution)
    size, found = prediction.size, float(form.arc[-1])
    close = size - slack < found
    if close and found < size:
        size = max((1 - _GIVING) * size, found)
    if close and not form.interpolated.any() and _is_along(form, prediction.nodes):
        return replace(form, hints=TrackHints(size=min(max(found, size), (1 + _GAINING) * size)))
    prediction = prediction._replace(size=size)
    known = _PredictedRope(prediction)
    whole = known.filled(known.turned(form))
    missing = known.size - whole.size
    if missing <= 0:
        return replace(whole, hints=TrackHints(size=min(whole.size, (1 + _GAINING) * prediction.size)))
    starts, costs = known.starts(whole)
    start = _start(starts, costs, prediction.hints.hidden[0], missing)
    piece = replace(known.completed(whole, start), hints=TrackHints((start, missing - start), slack))
    if costs.min() < known.disagreement(whole, 0.0, known.size):
        return piece
    return piece if depth is not None and is_hidden(piece, depth, prediction.width) else whole


def shown(form: FittedCurve) -> slice:
    """Return the piece of a matched curve over which points are spread: without ends hidden by less than the slack."""
    (head, tail), slack = form.hints.hidden, form.hints.slack
    first = np.searchsorted(form.arc, head - 1e-9) if head < slack else 0
    last = np.searchsorted(form.arc, form.size - tail + 1e-9) if tail < slack else len(form.points)
    return slice(int(first), int(last))


def _is_along(form: FittedCurve, nodes: Array) -> bool:
    """Return whether a curve clearly runs in the direction of ``(K, D)`` nodes, by the distances of its ends."""
    first, last = form.points[0].tolist(), form.points[-1].tolist()
    head, tail = nodes[0].tolist(), nodes[-1].tolist()
    forwards, backwards = dist(first, head) + dist(last, tail), dist(first, tail) + dist(last, head)
    return _CLEAR * forwards < backwards


def _start(starts: Array, costs: Array, before: float, missing: float) -> float:
    """Return where along the rope a visible piece starts."""
    inertia = _INERTIA * (starts - min(before, missing)) ** 2
    start = float(starts[np.argmin(costs + inertia)])
    if start <= _ONE_END * missing:
        return 0.0
    return missing if start >= (1 - _ONE_END) * missing else start


def _apart(first: Array, second: Array) -> float:
    return float(np.mean(np.sum((first - second) ** 2, axis=1)))


def _widest_gap(curve: FittedCurve) -> tuple[int, int]:
    """Return the last point before and the first after the widest bridged piece that has visible ones on both sides."""
    seen = np.flatnonzero(~curve.interpolated)
    if len(seen) < 2:
        return 0, 0
    widest = int(np.argmax(np.diff(curve.arc[seen])))
    return int(seen[widest]), int(seen[widest + 1])


class _PredictedRope:
    """The predicted rope from tip to tip.

    Args:
        prediction: Its nodes lie at the centres of K equal pieces.
    """

    def __init__(self, prediction: Prediction) -> None:
        nodes, self.size = prediction.nodes, prediction.size
        self.askew = _ASKEW * prediction.width
        gap = self.size / len(nodes)
        self.arc = np.concatenate([[0.0], (np.arange(len(nodes)) + 0.5) * gap, [self.size]])
        self.points = np.concatenate([1.5 * nodes[:1] - 0.5 * nodes[1:2], nodes, 1.5 * nodes[-1:] - 0.5 * nodes[-2:-1]])

    def distance(self, curve: FittedCurve) -> float:
        """Return the mean square distance between a curve and the whole rope, point by point."""
        share = np.linspace(0, 1, _PROBES)
        return _apart(self.at(share * self.size), curve.at(share * curve.size))

    def disagreement(self, curve: FittedCurve, start: float, end: float) -> float:
        """Return the mean square distance between a curve and the rope's piece from arc ``start`` to ``end``.

        Most of it is taken after the best rigid motion (Kabsch 1976): a prediction fails first in where a rope is,
        and last in how it is bent.
        """
        share = np.linspace(0, 1, _PROBES)
        expected, found = self.at(start + share * (end - start)), curve.at(share * curve.size)
        apart = _apart(expected, found)
        expected, found = expected - expected.mean(axis=0), found - found.mean(axis=0)
        u, overlap, v = np.linalg.svd(expected.T @ found)
        overlap[-1] *= np.sign(np.linalg.det(u @ v))
        bent = float(np.sum(expected**2) + np.sum(found**2) - 2 * overlap.sum()) / _PROBES
        return bent + _PLACE * apart

    def starts(self, curve: FittedCurve) -> tuple[Array, Array]:
        """Return arc positions at which a visible piece may begin, and how badly it agrees with the rope from there."""
        starts = np.linspace(0, max(self.size - curve.size, 0.0), _OFFSETS)
        return starts, np.array([self.disagreement(curve, start, start + curve.size) for start in starts])

    def turned(self, curve: FittedCurve) -> FittedCurve:
        """Return the curve in the rope's direction: as a whole, or if much is missing as a piece of the rope."""
        both = curve, curve.reversed()
        if curve.size > _MOST * self.size:
            return min(both, key=self.distance)
        return min(both, key=lambda piece: float(self.starts(piece)[1].min()))

    def at(self, arc: Array) -> Array:
        """Return ``(N, D)`` points at arc positions."""
        return interpolate(self.points, self.arc, arc)

    def filled(self, curve: FittedCurve) -> FittedCurve:
        """Return the curve with its widest gap bent as predicted: a straight bridge would make the rope too short."""
        first, last = _widest_gap(curve)
        before, after = float(curve.arc[first]), float(curve.arc[last])
        behind = self.size - (curve.size - after)
        if after - before < self.arc[2] or behind - before < self.arc[2]:
            return curve
        piece = self.at(np.linspace(before, behind, max(last - first + 1, 3)))
        chord, wanted = piece[-1] - piece[0], curve.points[last] - curve.points[first]
        scale = np.linalg.norm(wanted) / max(float(np.linalg.norm(chord)), 1e-9)
        if not 1 / _STRETCH < scale < _STRETCH:
            return curve
        # What is left over at the far end is spread along the piece, so that it meets both ends.
        piece = piece - piece[0] + curve.points[first]
        piece += np.linspace(0, 1, len(piece))[:, None] * (curve.points[last] - piece[-1])
        points = np.concatenate([curve.points[:first], piece, curve.points[last + 1 :]])
        inside = np.ones(len(piece), bool)
        inside[[0, -1]] = False
        bridged = np.concatenate([curve.interpolated[:first], inside, curve.interpolated[last + 1 :]])
        return curve.with_geometry(points, bridged)

    def completed(self, curve: FittedCurve, start: float) -> FittedCurve:
        """Return the visible piece that begins at arc ``start``, with the hidden ends before and behind it.

        A hand cuts a rope askew, and what is fitted turns into the longer side of the cut; near a long hidden end the
        rope is therefore as predicted too.
        """
        end = start + curve.size
        lost = start > 0, end < self.size - 1e-9
        first, last = (self.askew if hidden > LONG * self.size else 0.0 for hidden in (start, self.size - end))
        inner = (curve.arc >= first) & (curve.arc <= curve.size - last)
        if np.count_nonzero(inner) < 2:
            inner = np.ones(len(inner), bool)
        points, seen = curve.points[inner], curve.interpolated[inner]
        arc = start + curve.arc[inner]
        head = self._hidden(end=arc[0], joint=points[0]) if lost[0] else points[:0]
        tail = self._hidden(start=arc[-1], joint=points[-1]) if lost[1] else points[:0]
        # Only what is out of sight counts as hidden.
        before = np.linspace(0, arc[0], len(head) + 1)[:-1] < start
        behind = np.linspace(arc[-1], self.size, len(tail) + 1)[1:] > end
        return curve.with_geometry(np.concatenate([head, points, tail]), np.concatenate([before, seen, behind]))

    def _hidden(self, joint: Array, start: float = 0.0, end: float | None = None) -> Array:
        """Return the rope from arc ``start`` to ``end`` without its joint, moved there, of exactly that length."""
        at_start = end is not None
        stop = self.size if end is None else end
        length = stop - start
        if length <= 0:
            return np.zeros((0, len(joint)))
        arc = np.linspace(start, stop, max(int(np.ceil(length / self.arc[1])) + 1, 2))
        piece = self.at(arc)
        piece -= piece[-1 if at_start else 0]
        piece *= length / max(float(arc_length(piece)[-1]), 1e-9)
        return (piece[:-1] if at_start else piece[1:]) + joint
