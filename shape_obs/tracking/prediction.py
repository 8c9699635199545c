"""From frame to frame: what is remembered, and where the shape will be."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.form import Form, Memory
from shape_obs.geometry.topology import Topology
from shape_obs.image.roi import Window

Array = npt.NDArray[np.float64]

_VELOCITY_SHARE: Final = 0.8
_MAX_SIZE_CHANGE: Final = 0.06
_MAX_WIDTH_CHANGE: Final = 0.02
_WIDTH_NOISE: Final = 0.03
_LEAST_INTERVAL: Final = 1e-6  # seconds; stamps that are closer tell no velocity
_SPARE: Final = 8  # pixels around the place where a mask is expected


class Track(NamedTuple):
    """All the state there is of one shape.

    Args:
        nodes: (K,D) pixels or metres; a chain's lie at the centres of equal pieces of the curve.
        velocity: (K,D) units a second.
        interval: Seconds over which the velocity was seen.
        size: The size of the form (arc length of a curve), hidden pieces included.
        stamp: Seconds.
        topology: How the nodes hang together.
        memory: What the last form handed on beside its nodes.
        width: Of the body as a ribbon; 0 where that is not known.
        box: The rectangle around the mask; None without a mask.
        drift: By how much its edges have moved since the frame before, at most, pixels.
        amount: Pixels or points of the body; 0 where a part of it was hidden.
    """

    nodes: Array
    velocity: Array
    interval: float
    size: float
    stamp: float
    topology: Topology
    memory: Memory = Memory()
    width: float = 0.0
    box: Window | None = None
    drift: int = 0
    amount: int = 0


class Prediction(NamedTuple):
    """Where a shape should be.

    Args:
        nodes: (K,D).
        size: Of the form.
        topology: How the nodes hang together.
        memory: What the last form handed on beside its nodes.
        grain: What the body resolves: nothing smaller can be told from noise.
        width: Of the body as a ribbon; 0 where that is not known.
        amount: Pixels or points of the body in the last frame; 0 where a part of it was hidden.
        depth: (H,W) of the frame in which it is looked for, where there is one and the nodes are pixels: what lies
            over a place hides it.
    """

    nodes: Array
    size: float
    topology: Topology
    memory: Memory = Memory()
    grain: float = 0.0
    width: float = 0.0
    amount: int = 0
    depth: npt.NDArray[Any] | None = None


def predict(track: Track, stamp: float, grain: float) -> Prediction:
    """Where the nodes should be at ``stamp``: the last place plus most of the last step.

    Nothing is extrapolated farther than the last interval, so a shape that was lost is looked for near its last place.
    """
    ahead = min(max(stamp - track.stamp, 0.0), track.interval)
    nodes = track.nodes + _VELOCITY_SHARE * ahead * track.velocity
    return Prediction(nodes, track.size, track.topology, track.memory, grain, track.width, track.amount)


def advance(
    track: Track | None,
    nodes: Array,
    form: Form,
    stamp: float,
    topology: Topology,
    width: float,
    box: Window | None,
    amount: int,
) -> Track:
    """The track after a frame in which a form was found, its nodes, and of the body its width, its box and its pixels.

    Widths change slowly: what hides a piece that is not known to be hidden makes the rest no thinner. And they do not
    follow noise, or cells of another edge would gather the pixels from one frame to the next.
    """
    if track is not None and track.width and width:
        width = track.width * (1 + _follow(width / track.width - 1))
    amount = amount if form.whole else 0
    interval = 0.0 if track is None else stamp - track.stamp
    velocity = np.zeros_like(nodes)
    if track is not None and interval > _LEAST_INTERVAL:
        velocity = (nodes - track.nodes) / interval
    size = form.memory.size or form.size
    drift = 0 if track is None or track.box is None or box is None else _drift(track.box, box)
    return Track(nodes, velocity, max(interval, 0.0), size, stamp, topology, form.memory, width, box, drift, amount)


class Expected(NamedTuple):
    """Where a mask should be in the next frame.

    Args:
        window: Holds all of it, with room for what is not foreseen.
        width: Of the object where it is thinnest, pixels; 0 where that is not known.
    """

    window: Window
    width: float

    def united(self, other: Expected) -> Expected:
        """What holds both."""
        return Expected(self.window.united(other.window), min(self.width, other.width))


def outlook(track: Track) -> Expected | None:
    """Where the mask should be in the next frame; None where that is not known.

    What a hand hides may come back anywhere.
    """
    if track.box is None or any(track.memory.hidden):
        return None
    left, top, width, height = track.box
    spare = _SPARE + track.drift
    return Expected(Window(left - spare, top - spare, width + 2 * spare, height + 2 * spare), track.width)


def _follow(change: float) -> float:
    """The change of a width that is believed, as a share."""
    if abs(change) <= _WIDTH_NOISE:
        return 0.0
    return max(-_MAX_WIDTH_CHANGE, min(change, _MAX_WIDTH_CHANGE))


def _drift(before: Window, after: Window) -> int:
    """By how much the edges of a box have moved, at most, pixels."""
    (a, b, c, d), (e, f, g, h) = before, after
    return max(abs(a - e), abs(b - f), abs(a + c - e - g), abs(b + d - f - h))


def size_jump(before: float, after: float, unit: str) -> str:
    """Why a size cannot follow another; empty if it can."""
    if abs(after / before - 1) <= _MAX_SIZE_CHANGE:
        return ""
    digits = 0 if unit == "px" else 3
    return f"the length jumped from {before:.{digits}f} to {after:.{digits}f} {unit}"
