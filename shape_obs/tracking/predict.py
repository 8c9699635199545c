"""From frame to frame: what a track stores, where the shape will be, and how it has moved."""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.curve import NO_VALUES
from shape_obs.geometry.outline import with_turning
from shape_obs.geometry.topology import Chain, Topology
from shape_obs.tracking.model import MotionModel
from shape_obs.tracking.scene import Box
from shape_obs.tracking.state import ENDS, State

Array = npt.NDArray[np.float64]
#: The track of a shape before a frame, see ``Track``: its state, nodes, velocity, log-depth, how fast that changes, and
#: reference; the time now, seconds; whether it was lost for long; how far its nodes can have moved.
Before = tuple[State, Array, Array, Array, Array, Array, float, bool, float]

BEFORE_TYPE: Final = "Tuple(({}[::1], f8[:,::1], f8[:,::1], f8[::1], f8[::1], f8[:,::1], f8, b1, f8))"  # of a state
NO_NODES: Final = np.zeros((0, 2))  # without a track
_LEAST_INTERVAL: Final = 1e-6  # seconds; stamps that are closer give no velocity


class Track(NamedTuple):
    """All the state of one shape: arrays, and how its nodes are connected.

    Args:
        state: ``(1,)`` what is known besides its nodes, see ``RopeState`` and ``ShapeState``.
        nodes: ``(K, D)`` pixels or metres; a chain's lie at the centres of equal pieces of the curve.
        velocity: ``(K, D)`` units a second.
        topology: How the nodes are connected.
        log_depth: ``(K,)`` of the nodes in an image, see ``FittedCurve.log_depth``; ``(0,)`` without depth.
        depth_rate: ``(K,)`` how fast it changes, units a second; ``(0,)`` if that is not known.
        reference: ``(K, D')`` the nodes of the past by which an outline is numbered, or those of a sheet as it is
            known, wherever they lay, in metres if they were seen in space; ``(0, 2)`` if they are not known.
    """

    state: State
    nodes: Array
    velocity: Array
    topology: Topology
    log_depth: Array = NO_VALUES
    depth_rate: Array = NO_VALUES
    reference: Array = NO_NODES

    @property
    def stamp(self) -> float:
        """When the shape was seen, seconds."""
        return float(self.state["stamp"][0])

    @property
    def interval(self) -> float:
        """Over how many seconds its velocity was seen; 0 without one."""
        return float(self.state["interval"][0])

    @property
    def size(self) -> float:
        """The size of its form (arc length of a curve), hidden pieces included."""
        return float(self.state["size"][0])

    @property
    def width(self) -> float:
        """Of a rope, or of the largest piece of a mask; 0 in a cloud."""
        return float(self.state["width"][0])

    @property
    def rope(self) -> State | None:
        """``(1,)`` the state if the shape is a rope, see ``RopeState``; else None."""
        return self.state if isinstance(self.topology, Chain) else None

    @property
    def length_in_image(self) -> float:
        """The length in the image of a rope of which all was seen, pixels; 0 if it is not known."""
        rope = self.rope
        return 0.0 if rope is None or not rope["frames"][0] else float(rope["pixels"][0])

    def begun(self) -> Track:
        """Return the track as that of another object, which was seen for the first time."""
        state = self.state.copy()
        state["interval"], state["box_motion"], state["width"] = 0.0, 0, state["seen_width"]
        return self._replace(state=state, velocity=np.zeros_like(self.velocity), depth_rate=NO_VALUES)


def reversed_rope(track: Track, points: int) -> Track:
    """Return the track of the same rope, which begins at its other end.

    Args:
        track: Of a rope.
        points: Of its curve.
    """
    state, was = track.state.copy(), track.state
    for name in ENDS:
        state[name] = was[name][:, ::-1]
    state["tips"] = was["tips"][:, :, ::-1]
    state["shown"] = points - was["shown"][:, ::-1]
    nodes, velocity, deep, rate = (
        each[::-1].copy() for each in (track.nodes, track.velocity, track.log_depth, track.depth_rate)
    )
    return track._replace(state=state, nodes=nodes, velocity=velocity, log_depth=deep, depth_rate=rate)


class Fit(NamedTuple):
    """The result of fitting a shape to one frame.

    Args:
        form: In the order of the points; None when nothing was found.
        quality: 0...1.
        reason: Why it was refused; empty if it was not.
        track: The track, if it goes on with this form; None without a form.
        observed: What the form was fitted to.
        object_width: The width of the object that the fit assumed.
        follow: Whether the track goes on with a form that was refused: it may still show where the object is.
        centres: ``(N, D)`` the shape's points in order if a clusterer found them; None if the form gives them.
        new: Whether the numbering begins again, though there was a track: the object is another one.
        same: Whether a rope that was lost for long has kept its numbering, see ``memory``.
    """

    form: Any = None
    quality: float = 0.0
    reason: str = ""
    track: Track | None = None
    observed: Any = None
    object_width: float = 0.0
    follow: bool = False
    centres: Array | None = None
    new: bool = False
    same: bool = False

    @property
    def size(self) -> float:
        """The size of the form, which must not jump from frame to frame; 0 without one."""
        return 0.0 if self.form is None else self.form.size


class Prediction(NamedTuple):
    """What is known of a shape before a frame.

    Args:
        track: Where it was, and all that is known of it.
        now: When the frame was taken, seconds.
        model: How it moves.
        lost: For longer than ``max_age``, so that its numbering may begin again.
        reach: How far its nodes can have moved; infinity without a limit.
    """

    track: Track
    now: float
    model: MotionModel
    lost: bool = False
    reach: float = math.inf

    @property
    def before(self) -> Before:
        """The track as steps take it."""
        (state, nodes, velocity, _, log_depth, depth_rate, reference), now, _, lost, reach = self
        return state, nodes, velocity, log_depth, depth_rate, reference, now, lost, reach

    @property
    def nodes(self) -> Array:
        """``(K, D)`` where they should be."""
        track, share = self.track, self.model.velocity_share
        moving = track.nodes, track.velocity, track.log_depth, track.depth_rate
        return predict(*moving, self.seconds, track.interval, share)[0]

    @property
    def seconds(self) -> float:
        """Since the track saw the shape."""
        return self.now - self.track.stamp

    @property
    def intervals(self) -> float:
        """How long ago the object was seen last, in intervals of the track, at least 1."""
        return max(self.seconds / self.track.interval, 1.0) if self.track.interval > 0 else 1.0


def unknown_before(new: State, dimension: int, now: float) -> Before:
    """Return what steps take of a shape without a track: the state of a new one, and no nodes."""
    nothing = np.empty((0, dimension))
    return new, nothing, nothing, NO_VALUES, NO_VALUES, NO_NODES, now, False, math.inf


@compiled("(f8[:,::1], f8[:,::1], f8[::1], f8[::1], f8, f8, f8)")
def predict(
    nodes: Array, velocity: Array, log_depth: Array, depth_rate: Array, seconds: float, interval: float, share: float
) -> tuple[Array, Array, float]:
    """Predict the nodes: they go on with most of their velocity.

    A velocity lasts for as long as it was seen, so that a shape that was lost is searched near its last place.

    Args:
        nodes: ``(K, D)`` where they were; ``(0, D)`` without a track.
        velocity: ``(K, D)``.
        log_depth: ``(K,)`` or ``(0,)``.
        depth_rate: The same.
        seconds: Since then.
        interval: Over how many seconds the velocity was seen.
        share: Of the velocity, with which they go on.

    Returns:
        Nodes and log-depth now, and how far the nodes move, RMS.
    """
    moved, deep, square, ahead = np.empty_like(nodes), log_depth.copy(), 0.0, share * min(max(seconds, 0.0), interval)
    for k in range(len(nodes)):
        for d in range(nodes.shape[1]):
            moved[k, d] = nodes[k, d] + ahead * velocity[k, d]
            square += (ahead * velocity[k, d]) ** 2
    for k in range(len(depth_rate)):
        deep[k] += ahead * depth_rate[k]
    return moved, deep, math.sqrt(square / max(len(nodes), 1))


@compiled
def counted(seconds: float, model: Any) -> float:
    """Return for how many seconds a frame counts in what is learnt, that many after the last one."""
    return min(max(seconds, 0.0), model.longest_interval)


@compiled
def advance(
    known: Any, now: Any, nodes: Array, before: Array, log_depth: Array, log_depth_before: Array, stamp: float,
    size: float, width: float, box: Box, turning: float, model: Any,
) -> tuple[Array, Array]:  # fmt: skip
    """Write into a state how a shape has moved to where it was found.

    Widths change slowly: what hides a piece that is not known to be hidden makes the rest no thinner. And they do not
    follow noise, or cells of another edge would gather the pixels from one frame to the next.

    Args:
        known: The state of its track.
        now: The state after this frame; written to.
        nodes: ``(K, D)`` where it was found.
        before: ``(K, D)`` where it was; ``(0, D)`` without a track.
        log_depth: ``(K,)`` or ``(0,)``, of the nodes.
        log_depth_before: The same of those before.
        stamp: Of the frame, seconds.
        size: Of the form.
        width: Of the object; 0 if it is not known.
        box: Around the mask.
        turning: The share of the nodes' common motion along a closed curve that is believed.
        model: The constants.

    Returns:
        ``(K, D)`` velocity; ``(K,)`` or ``(0,)`` how fast the log-depth changes; units a second.
    """
    now.stamp, now.interval, now.size, now.width, now.seen_width = stamp, 0.0, size, width, width
    now.box_motion = 0
    for k in range(4):
        now.box[k] = box[k]
    velocity, depth_rate = np.zeros_like(nodes), log_depth[:0]
    if len(before) == 0:
        return velocity, depth_rate
    seconds = stamp - known.stamp
    now.interval = max(seconds, 0.0)
    if known.width > 0 and width > 0:
        now.width = known.width * (1 + _believed(width / known.width - 1, seconds, model))
    if known.box[2] > 0 and box[2] > 0:
        left, top = abs(known.box[0] - box[0]), abs(known.box[1] - box[1])
        right = abs(known.box[0] + known.box[2] - box[0] - box[2])
        now.box_motion = max(left, top, right, abs(known.box[1] + known.box[3] - box[1] - box[3]))
    if seconds <= _LEAST_INTERVAL:
        return velocity, depth_rate
    for k in range(len(nodes)):
        for d in range(nodes.shape[1]):
            velocity[k, d] = (nodes[k, d] - before[k, d]) / seconds
    if len(log_depth) > 0 and len(log_depth_before) > 0:
        depth_rate = np.empty(len(log_depth))
        for k in range(len(log_depth)):
            depth_rate[k] = (log_depth[k] - log_depth_before[k]) / seconds
    return (velocity if turning == 1 else with_turning(nodes, velocity, turning)), depth_rate


@compiled
def _believed(change: float, seconds: float, model: Any) -> float:
    """Return the part of a width's relative change that is not noise, limited by the time that has passed."""
    if abs(change) <= model.width_noise:
        return 0.0
    most = model.max_width_change * counted(seconds, model)
    return max(-most, min(change, most))
