"""Passages: ropes that lay over each other may have changed places; how they are bent and how long they are says so."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from itertools import combinations
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.curve import NO_VALUES
from shape_obs.geometry.polyline import interpolate
from shape_obs.geometry.rotation import fit
from shape_obs.slots.attempts import Attempt, Seen, in_image
from shape_obs.tracking.exchanges import TOUCH
from shape_obs.tracking.predict import Track
from shape_obs.tracking.scene_doubt import sides_of
from shape_obs.tracking.state import State

Array = npt.NDArray[np.float64]
Pair = tuple[int, int]  # of slots

_WINDOW: Final = 6  # frames: ropes keep their bends for so long, and hardly take longer to part again
_SHARE: Final = 0.3  # of a rope's nodes that are near another rope if the two touch or lie over each other
_OVER: Final = 0.6  # widths between the middles of ropes that lie over each other
_BENDS: Final = 0.1  # rad, RMS: change of heading within the window that noise and motion explain
_NOISE: Final = 3.0  # standard deviations by which noise makes a length too long
_LONGEST: Final = 5.0  # standard deviations beyond that count at most: one wrong length decides nothing
_STRANGE: Final = 4.0  # squared standard deviations by which ropes have to differ from what they were: two sigma
_REMAINS: Final = 0.6  # share of that difference that may remain after an exchange
_CLEAR: Final = 5.0  # squares of a width: no more may speak against the fits after an exchange
_AGAIN: Final = 1.1  # times that ropes differ more, before an exchange that was refused is tried again


class Lying(NamedTuple):
    """How a rope lies in a frame.

    Args:
        nodes: ``(K, D)`` pixels or metres, of its track.
        pixels: ``(K, 2)`` the same in the image.
        visible: How much of it is visible, pixels; 0 where it meets another one and that is uncertain.
        known: ``(1,)`` what is known of it, see ``RopeState``; None of what is no rope.
    """

    nodes: Array
    pixels: Array
    visible: float
    known: State | None


class Passages:
    """Remember how ropes lay in the last few frames, and notice two that may have been exchanged."""

    def __init__(self) -> None:
        self._past: deque[Sequence[Lying | None]] = deque(maxlen=_WINDOW)
        # For how many frames more two ropes may have been exchanged, which touched or lay over each other.
        self._touched: dict[Pair, int] = {}
        self._lay_over: dict[Pair, int] = {}
        self._refused: dict[Pair, float] = {}  # by how much they differed then

    def add(self, ropes: Sequence[Lying | None], width: float) -> None:
        """Remember how ropes lie after a frame; None for one that was not found.

        Args:
            ropes: One for each slot.
            width: Of the ropes, pixels.
        """
        self._past.append(ropes)
        for pair in combinations(range(len(ropes)), 2):
            one, other = (ropes[k] for k in pair)
            apart = math.inf if one is None or other is None else _apart(one.pixels, other.pixels, TOUCH * width)
            for recent, near in ((self._touched, TOUCH), (self._lay_over, _OVER)):
                if apart < near * width:
                    recent[pair] = _WINDOW
                elif recent.get(pair):
                    recent[pair] -= 1

    def doubtful(self, ropes: Sequence[Lying | None]) -> dict[Pair, float]:
        """Return the pairs of slots that may have been exchanged, and by how much they differ from what they were.

        Args:
            ropes: As they lie in this frame.
        """
        strange = {pair: self.strangeness(ropes, pair) for pair, left in self._touched.items() if left}
        strange = {pair: amount for pair, amount in strange.items() if amount > _STRANGE}
        self._refused = {pair: amount for pair, amount in self._refused.items() if pair in strange}
        return {pair: amount for pair, amount in strange.items() if amount > _AGAIN * self._refused.get(pair, 0.0)}

    def refuse(self, pair: Pair, strange: float) -> None:
        """Remember that ropes that differ from what they were have not been exchanged."""
        self._refused[pair] = strange

    def strangeness(self, ropes: Sequence[Lying | None], pair: Pair) -> float:
        """Return by how much two ropes differ from what they were, in squared standard deviations.

        A rope may look shorter than it is, where something hides it, but never longer.
        """
        total = 0.0
        for k in pair:
            now, before = ropes[k], self.before(k)
            if now is None or before is None:
                return math.inf if self._lay_over.get(pair) else 0.0
            if self._lay_over.get(pair):  # next to each other, ropes may well bend alike
                total += (change_of_headings(now.pixels, before.pixels) / _BENDS) ** 2
            rope = None if before.known is None or not before.known["frames"][0] else before.known[0]
            if rope is not None and now.visible > rope["pixels"] > 0:
                off = (now.visible / float(rope["pixels"]) - 1) / max(float(rope["pixels_spread"]), 1e-3)
                total += min(max(off - _NOISE, 0.0), _LONGEST) ** 2
        return total

    def before(self, slot: int) -> Lying | None:
        """Return how the rope of a slot lay before it may have been exchanged; None if that is not known."""
        return self._past[0][slot] if len(self._past) == _WINDOW else None


def lying_of(seen: Seen, tries: Sequence[Attempt | None], met: Sequence[int]) -> list[Lying | None]:
    """Return how the ropes of all slots lie; None for one that was not found.

    Args:
        seen: The frame.
        tries: What was fitted to it.
        met: Slots whose ropes meet others.
    """
    lying: list[Lying | None] = []
    for k, (each, track) in enumerate(zip(tries, seen.tracks, strict=True)):
        if each is None or track is None or not each.is_found or each.found.track is None:
            lying.append(None)
            continue
        form, nodes = each.found.form, each.found.track.nodes
        apart = k not in met and form.points.shape[1] == 2
        visible = form.size * (1 - form.unsupported_fraction) if apart else 0.0
        lying.append(Lying(nodes, in_image(nodes, seen.scene), visible, track.rope))
    return lying


def better(strange: float, doubt: float, strange_before: float, doubt_before: float) -> bool:
    """Return whether ropes that were exchanged are like what they were, and what speaks against the fits is no more.

    Args:
        strange: After the exchange, see ``Passages.strangeness``.
        doubt: What speaks against the fits, in squares of a width.
        strange_before: Before the exchange.
        doubt_before: The same.
    """
    if doubt > _CLEAR or strange > _REMAINS * strange_before:
        return False
    return doubt + strange / _STRANGE < doubt_before + strange_before / _STRANGE


def moved(own: Track, other: Track, before: Lying) -> Track:
    """Return the track of a rope that lies where another one was thought to be, and is bent as it was itself.

    Args:
        own: Its track.
        other: The track of the other one.
        before: How the rope lay before.
    """
    nodes = _laid_onto(before.nodes, other.nodes)
    velocity = np.broadcast_to(other.velocity.mean(axis=0), nodes.shape).copy()
    state = own.state.copy()
    state["box"] = other.state["box"]
    state["hidden"] = state["hides"] = state["occluded"] = state["folded"] = state["drift"] = 0
    return own._replace(state=state, nodes=nodes, velocity=velocity, log_depth=NO_VALUES, depth_rate=NO_VALUES)


def _laid_onto(own: Array, other: Array) -> Array:
    """Return ``(K, D)`` nodes of a rope in its own shape, laid onto another rope without being turned round."""
    if (other[-1] - other[0]) @ (own[-1] - own[0]) < 0:
        other = np.ascontiguousarray(other[::-1])
    target = interpolate(other, np.arange(float(len(other))), np.linspace(0.0, len(other) - 1.0, len(own)))
    return np.ascontiguousarray(fit(own, target).apply(own))


def _apart(one: Array, other: Array, far: float) -> float:
    """Return within which distance of another rope a share of a rope's nodes lies; inf if they are far apart."""
    if (one.max(axis=0) < other.min(axis=0) - far).any() or (other.max(axis=0) < one.min(axis=0) - far).any():
        return math.inf
    return float(np.quantile(sides_of(one, other)[0], _SHARE))


@compiled("(f8[:,::1], f8[:,::1])")
def change_of_headings(nodes: Array, before: Array) -> float:
    """Return the RMS difference of the headings of two polylines, in radians, but for a rotation."""
    count = max(len(nodes), len(before)) - 1
    total = squares = difference = 0.0
    for k in range(count):
        angle = _heading(nodes, k, count) - _heading(before, k, count)
        difference += (angle - difference + np.pi) % (2 * np.pi) - np.pi  # goes on from piece to piece
        total += difference
        squares += difference * difference
    return np.sqrt(max(squares / count - (total / count) ** 2, 0.0))


@compiled
def _heading(nodes: Array, piece: int, count: int) -> float:
    """Return the heading of one of ``count`` pieces of a polyline, in radians."""
    u = v = 0.0
    for end in range(2):
        at = (piece + end) * (len(nodes) - 1) / count
        k = min(int(at), len(nodes) - 2)
        share, sign = at - k, 2 * end - 1
        u += sign * (nodes[k, 0] + share * (nodes[k + 1, 0] - nodes[k, 0]))
        v += sign * (nodes[k, 1] + share * (nodes[k + 1, 1] - nodes[k, 1]))
    return np.arctan2(v, u)
