"""Where a known rope is expected, and which way a visible curve runs along it."""

from __future__ import annotations

import math
from dataclasses import replace
from operator import ne
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.polyline import interpolate
from shape_obs.geometry.topology import from_tip_to_tip
from shape_obs.tracking.occluders import Tips
from shape_obs.tracking.placement import INDEPENDENT, NOISE, PROBES, TRUST
from shape_obs.tracking.prediction import Prediction

Array = npt.NDArray[np.float64]

_UNSEEN: Final = 30.0  # squared standard deviations: a piece that lies where all was folded back is so unlikely
_CLEAR: Final = 3.0  # how much nearer ends lie to their own places than to each other's
_SURE: Final = 8.0  # squared standard deviations by which the other direction has to be less likely
_UNCOVERING: Final = 2.0  # in a second, an end goes out of sight or comes to light, about
_PLACES: Final = 7  # along the rope, at which a piece is compared with it to find its direction
_FEWEST: Final = 6  # nodes of a visible piece


def oriented(form: FittedCurve, rope: PredictedRope, tips: Tips) -> tuple[FittedCurve, bool]:
    """Return a curve in the direction of the predicted rope, of which it may be a piece, and whether it was reversed.

    What hides an end, such as the image's border, hides it still. A direction that is in doubt is noted as the curve's
    ambiguity.
    """
    if _is_along(rope.points_of(form), rope.nodes):
        return form, False
    if way := direction(form.points, rope.prediction):
        return (form, False) if way > 0 else (form.reversed(), True)
    whole = float(rope.state["pixels" if form.metres is None else "metres"])
    seen = min(float(form.stations[-1]) / whole, 1.0) if whole > 0 else 1.0
    back = form.reversed()
    uncovered = -2 * math.log(math.tanh(max(_UNCOVERING * rope.prediction.seconds, 1e-9)))  # a chain of two states
    off, off_back = (
        rope.doubt(curve, seen) + uncovered * sum(map(ne, rope.state["occluded"], covered))
        for curve, covered in ((form, tips.covered), (back, tips.covered[::-1]))
    )
    if abs(off - off_back) < _SURE:
        form, back = (replace(curve, ambiguity="it is in doubt where the rope begins") for curve in (form, back))
    return (back, True) if off_back < off else (form, False)


def direction(points: Array, prediction: Prediction) -> int:
    """Return whether the ends of a curve must have come from their own places (1), or each other's (-1); else 0."""
    if math.isinf(prediction.reach):
        return 0
    before = prediction.last[[0, -1]]
    own, other = (float(np.linalg.norm(points[ends] - before, axis=1).mean()) for ends in ([0, -1], [-1, 0]))
    return int(own <= prediction.reach < other) - int(other <= prediction.reach < own)


class Nodes(NamedTuple):
    """Predicted nodes.

    Args:
        nodes: ``(K, D)``.
        relief: ``(K,)`` depth at the nodes in an image, see ``FittedCurve.relief``; None without depth.
    """

    nodes: Array
    relief: Array | None


def visible_nodes(prediction: Prediction) -> Nodes:
    """Return the predicted nodes of the visible piece, about as far apart."""
    rope = PredictedRope(prediction)
    head, tail = rope.hidden
    first, last = head, 1 - tail
    count = max(round(len(rope.nodes) * (last - first)), _FEWEST)
    nodes = rope.at(first + (np.arange(count) + 0.5) / count * (last - first))
    if prediction.relief is None:
        return Nodes(nodes, None)
    return Nodes(nodes[:, :2].copy(), nodes[:, 2].copy())


def _is_along(points: Array, nodes: Array) -> bool:
    """Return whether a curve clearly runs in the direction of ``(K, D)`` nodes, by the distances of its ends."""
    first, last = points[0].tolist(), points[-1].tolist()
    head, tail = nodes[0].tolist(), nodes[-1].tolist()
    forwards, backwards = math.dist(first, head) + math.dist(last, tail), math.dist(first, tail) + math.dist(last, head)
    return _CLEAR * forwards < backwards


class PredictedRope:
    """The predicted rope from tip to tip.

    Args:
        prediction: Its nodes lie at the centres of K equal pieces of the rope.
        form: What it is compared with: in the image, if its relief is not known.

    Attributes:
        prediction: See above.
        state: What is known of the rope, a record of ``RopeState``.
        nodes: ``(K, D)``.
        points: ``(K + 2, D)`` the nodes, and the tips in front of and behind them.
        share: ``(K + 2,)`` where the points lie along the rope, 0...1.
        lifted: Whether the last coordinate is their relief.
    """

    def __init__(self, prediction: Prediction, form: FittedCurve | None = None) -> None:
        self.prediction = prediction
        nodes, self.state = prediction.nodes, prediction.hints.rope[0]
        self.hidden, self.folded = self.state["hidden"].tolist(), self.state["folded"].tolist()
        deep = prediction.relief
        self.lifted = deep is not None and (form is None or form.relief is not None)
        if deep is not None and self.lifted:
            nodes = np.concatenate([nodes, deep[:, None]], axis=1)
        self.nodes = np.ascontiguousarray(nodes)
        self.points, self.share = from_tip_to_tip(self.nodes)
        # An object that moves as it likes is as far from its prediction as the square of the time that went by.
        self.residuals = float(self.state["shape_innovation"]), float(self.state["pose_innovation"])
        self.lapse = prediction.lapse**2
        self.resolution = prediction.resolution

    def at(self, share: Array) -> Array:
        """Return ``(N, D)`` points at shares of the length."""
        return interpolate(self.points, self.share, share)

    def points_of(self, form: FittedCurve) -> Array:
        """Return ``(P, D)`` the points of a curve, in the coordinates of the rope."""
        return form.lifted if self.nodes.shape[1] > form.points.shape[1] else form.points

    def doubt(self, form: FittedCurve, share: float) -> float:
        """Return how unlikely a curve is the piece of the rope, that long, which it resembles most.

        Args:
            form: The curve.
            share: Of the rope's length.
        """
        found = interpolate(self.points_of(form), form.stations, PROBES * form.stations[-1])
        head, tail = (hidden * folded for hidden, folded in zip(self.hidden, self.folded, strict=True))
        floor = (NOISE * self.resolution) ** 2
        usual = max(self.lapse * self.residuals[0], floor), max(self.lapse * self.residuals[1], floor)
        return least_doubt(self.points, self.share, found, share, (head, tail), usual)


@compiled("(f8[:,::1], f8[::1], f8[:,::1], f8, UniTuple(f8, 2), UniTuple(f8, 2))")
def least_doubt(
    points: Array, share: Array, found: Array, size: float, folded: tuple[float, float], usual: tuple[float, float]
) -> float:
    """Return how unlikely a curve is a piece of a rope, the likeliest of seven, in squared standard deviations.

    Args:
        points: ``(K, D)`` of the rope.
        share: ``(K,)`` where they lie along it, 0...1.
        found: ``(32, D)`` at equal steps along the curve.
        size: Share of the rope that the curve is long.
        folded: Shares at both ends of the rope that were folded back: with them nothing can be compared.
        usual: Mean square distances of curves from their predictions: after a shift, and as they are.
    """
    probes, least = len(found), np.inf
    for place in range(_PLACES):
        at = place / (_PLACES - 1) * (1 - size) + size * PROBES
        expected, known, square, shift = interpolate(points, share, at), 0, 0.0, np.zeros(points.shape[1])
        for n in range(probes):
            if folded[0] <= at[n] <= 1 - folded[1]:
                known += 1
                for d in range(len(shift)):
                    shift[d] += expected[n, d] - found[n, d]
                    square += (expected[n, d] - found[n, d]) ** 2
        doubt = _UNSEEN * (1 - known / probes)
        if known > 0:
            apart = np.sum(shift**2) / known**2
            for off, known_off, count in (
                (square / known - apart, usual[0], INDEPENDENT[0]), (apart, usual[1], INDEPENDENT[1])
            ):  # fmt: skip
                doubt += TRUST * math.log1p(count * max(off, 0.0) / known_off / TRUST)
        least = min(least, doubt)
    return least
