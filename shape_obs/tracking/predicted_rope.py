"""Where a known rope is expected, and which way a visible curve runs along it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.curve import FittedCurve, Length
from shape_obs.geometry.polyline import interpolate
from shape_obs.geometry.topology import from_tip_to_tip
from shape_obs.tracking.placement import INDEPENDENT, NOISE, PROBES, TRUST
from shape_obs.tracking.prediction import Prediction

Array = npt.NDArray[np.float64]

_UNSEEN: Final = 30.0  # squared standard deviations: a piece that lies where all was folded back is so unlikely
_CLEAR: Final = 3.0  # how much nearer ends lie to their own places than to each other's
_ASKEW: Final = 0.6  # widths: of the visible piece next to a hidden end, which may follow the cut
_SURE: Final = 8.0  # squared standard deviations by which the other direction has to be less likely
_PLACES: Final = 7  # along the rope, at which a piece is compared with it to find its direction
_FEWEST: Final = 6  # nodes of a visible piece


def oriented(form: FittedCurve, rope: PredictedRope, length: Length) -> tuple[FittedCurve, bool]:
    """Return a curve in the direction of the predicted rope, of which it may be a piece, and whether it was reversed.

    A direction that is in doubt is noted as the curve's ambiguity.
    """
    if _is_along(rope.points_of(form), rope.nodes):
        return form, False
    whole = length.metres if form.metres is not None else length.pixels
    seen = min(float(form.stations[-1]) / whole, 1.0) if whole > 0 else 1.0
    firsts, back = np.linspace(0, 1 - seen, _PLACES), form.reversed()
    off, off_back = (min(rope.doubt(rope.along(curve), first, seen) for first in firsts) for curve in (form, back))
    if abs(off - off_back) < _SURE:
        form, back = (replace(curve, ambiguity="it is in doubt where the rope begins") for curve in (form, back))
    return (back, True) if off_back < off else (form, False)


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
    (head, tail), rope = prediction.hints.hidden, PredictedRope(prediction)
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
        nodes: ``(K, D)``.
        points: ``(K + 2, D)`` the nodes, and the tips in front of and behind them.
        share: ``(K + 2,)`` where the points lie along the rope, 0...1.
        lifted: Whether the last coordinate is their relief.
    """

    def __init__(self, prediction: Prediction, form: FittedCurve | None = None) -> None:
        nodes, self.hidden, self.folded = prediction.nodes, prediction.hints.hidden, prediction.hints.folded
        self.lifted = prediction.relief is not None and (form is None or form.relief is not None)
        if prediction.relief is not None and self.lifted:
            nodes = np.concatenate([nodes, prediction.relief[:, None]], axis=1)
        self.nodes = np.ascontiguousarray(nodes)
        self.points, self.share = from_tip_to_tip(self.nodes)
        # An object that moves as it likes is as far from its prediction as the square of the time that went by.
        self.residuals, self.lapse = prediction.hints.residuals, prediction.lapse**2
        self.askew, self.resolution = _ASKEW * prediction.width, prediction.resolution

    def at(self, share: Array) -> Array:
        """Return ``(N, D)`` points at shares of the length."""
        return interpolate(self.points, self.share, share)

    def points_of(self, form: FittedCurve) -> Array:
        """Return ``(P, D)`` the points of a curve, in the coordinates of the rope."""
        return form.lifted if self.nodes.shape[1] > form.points.shape[1] else form.points

    def along(self, form: FittedCurve) -> Array:
        """Return ``(32, D)`` points at equal steps along a curve."""
        return interpolate(self.points_of(form), form.stations, PROBES * form.stations[-1])

    def doubt(self, found: Array, first: float, share: float) -> float:
        """Return how unlikely ``(32, D)`` points along a curve are a piece of the rope, in squared standard deviations.

        Args:
            found: The points.
            first: Where the piece begins, as a share of the rope's length.
            share: How long it is. What was folded back cannot be compared with it.
        """
        at = first + share * PROBES
        head, tail = (hidden * folded for hidden, folded in zip(self.hidden, self.folded, strict=True))
        seen = (at >= head) & (at <= 1 - tail)
        doubt = _UNSEEN * (1 - float(seen.mean()))
        if not seen.any():
            return doubt
        away = (self.at(at) - found)[seen]
        shift, least = away.mean(axis=0), (NOISE * self.resolution) ** 2
        off = float(np.mean(np.sum((away - shift) ** 2, axis=1))), float(np.sum(shift**2))
        for now, usual, count in zip(off, self.residuals, INDEPENDENT, strict=True):
            doubt += TRUST * math.log1p(count * now / max(self.lapse * usual, least) / TRUST)
        return doubt
