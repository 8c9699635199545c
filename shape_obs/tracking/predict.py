"""From frame to frame: what a track stores, and where the shape will be."""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.curve import NO_VALUES, FittedForm, TrackHints
from shape_obs.geometry.observed import Observed
from shape_obs.geometry.outline import with_turning
from shape_obs.geometry.topology import Topology
from shape_obs.image.roi import Window
from shape_obs.tracking.model import MotionModel

Array = npt.NDArray[np.float64]

_LEAST_INTERVAL: Final = 1e-6  # seconds; stamps that are closer give no velocity


class Fit(NamedTuple):
    """The result of fitting a shape to one frame.

    Args:
        form: In the order of the points; None when nothing was found.
        quality: 0...1.
        reason: Why it was refused; empty if it was not.
        nodes: ``(K, D)`` the map's nodes on the form, for the track.
        topology: How the nodes are connected.
        width: Of the object, for the next frame; 0 if it is not known beforehand.
        observed: What the form was fitted to.
        object_width: The width of the object that the fit assumed.
        follow: Whether the track goes on with a form that was refused: it may still show where the object is.
        centres: ``(N, D)`` the shape's points in order if a clusterer found them; None if the form gives them.
        new: Whether the numbering begins again, though there was a track: the object is another one.
        track_id: The number of the track that the form belongs to.
        log_depth: ``(K,)`` of the nodes of a chain in an image, see ``FittedCurve.log_depth``; ``(0,)`` without depth.
    """

    form: Any = None
    quality: float = 0.0
    reason: str = ""
    nodes: Array | None = None
    topology: Topology | None = None
    width: float = 0.0
    observed: Any = None
    object_width: float = 0.0
    follow: bool = False
    centres: Array | None = None
    new: bool = False
    track_id: int = 0
    log_depth: Array = NO_VALUES

    @property
    def size(self) -> float:
        """The size of the form, which must not jump from frame to frame; 0 without one."""
        return 0.0 if self.form is None else self.form.size


class Track(NamedTuple):
    """All the state of one shape.

    Args:
        nodes: ``(K, D)`` pixels or metres; a chain's lie at the centres of equal pieces of the curve.
        velocity: ``(K, D)`` units a second.
        interval: Seconds over which the velocity was seen.
        size: The size of the form (arc length of a curve), hidden pieces included.
        stamp: Seconds.
        topology: How the nodes are connected.
        hints: What the last form passed on in addition to its nodes.
        width: Of the object as a ribbon; 0 if it is not known.
        box: The rectangle around the mask; None without a mask.
        drift: By how much its edges have moved since the frame before, at most, pixels.
        area: Pixels or points of the object; 0 if a part of it was hidden.
        track_id: Its number among the tracks of the shape, from 1.
        log_depth: ``(K,)`` of the nodes in an image, see ``FittedCurve.log_depth``; ``(0,)`` without depth.
        depth_rate: ``(K,)`` how fast it changes, units a second; ``(0,)`` if that is not known.
    """

    nodes: Array
    velocity: Array
    interval: float
    size: float
    stamp: float
    topology: Topology
    hints: TrackHints = TrackHints()
    width: float = 0.0
    box: Window | None = None
    drift: int = 0
    area: int = 0
    track_id: int = 0
    log_depth: Array = NO_VALUES
    depth_rate: Array = NO_VALUES


class Prediction(NamedTuple):
    """Where a shape should be.

    Args:
        track: Where it was, and all that is known of it.
        nodes: ``(K, D)`` where they should be.
        log_depth: ``(K,)`` of the nodes in an image, see ``FittedCurve.log_depth``; ``(0,)`` without depth.
        motion: How far the nodes are expected to have moved, RMS.
        seconds: Since the track saw the shape.
        lasted: For how many of them this frame counts in what is learnt.
        resolution: Of the observation: nothing smaller can be distinguished from noise.
        steady: Whether all of the object was seen and is: what comes to light, or under a hand, changes its area first.
        stale: Whether the shape was lost for so long that its numbering begins again.
        reach: How far the nodes can have moved; infinity without a limit.
    """

    track: Track
    nodes: Array
    log_depth: Array
    motion: float
    seconds: float
    lasted: float
    resolution: float
    steady: bool
    stale: bool = False
    reach: float = math.inf

    @property
    def intervals(self) -> float:
        """How long ago the object was seen last, in intervals of the track, at least 1."""
        return max(self.seconds / self.track.interval, 1.0) if self.track.interval > 0 else 1.0


def length_in_image(track: Track | None) -> float:
    """Return the length in the image of a rope of which all was seen, pixels; 0 if it is not known."""
    rope = None if track is None else track.hints.rope
    return 0.0 if rope is None or not rope["frames"][0] else float(rope["pixels"][0])


def predict(
    track: Track, observed: Observed, now: float, model: MotionModel, stale: bool = False, reach: float = math.inf
) -> Prediction:
    """Predict the nodes: they go on with most of their velocity.

    A velocity lasts for as long as it was seen, so that a shape that was lost is searched near its last place.
    ``stale`` and ``reach`` are those of the prediction.
    """
    since = now - track.stamp
    ahead = model.velocity_share * min(max(since, 0.0), track.interval)
    nodes, log_depth, motion = extrapolated(track.nodes, track.velocity, track.log_depth, track.depth_rate, ahead)
    steady, lasted = abs(observed.area - track.area) <= model.steady * track.area, model.lasted(since)
    return Prediction(track, nodes, log_depth, motion, since, lasted, observed.resolution, steady, stale, reach)


def advance(track: Track | None, found: Fit, observed: Observed, now: float, model: MotionModel) -> Track:
    """Return the track after a frame in which a form was found.

    Widths change slowly: what hides a piece that is not known to be hidden makes the rest no thinner. And they do not
    follow noise, or cells of another edge would gather the pixels from one frame to the next.
    """
    form: FittedForm = found.form
    nodes, topology, width, box, depth_rate = found.nodes, found.topology, found.width, observed.box, NO_VALUES
    assert nodes is not None
    assert topology is not None
    if track is not None and track.width and width:
        width = track.width * (1 + _believed(width / track.width - 1, now - track.stamp, model))
    interval = 0.0 if track is None else now - track.stamp
    if track is not None and interval > _LEAST_INTERVAL:
        turning = 1.0 if form.hints.turning is None else form.hints.turning / model.velocity_share
        velocity, depth_rate = rates(nodes, track.nodes, found.log_depth, track.log_depth, interval, turning)
    else:
        velocity = np.zeros_like(nodes)
    area = 0 if np.count_nonzero(form.interpolated) else observed.area
    drift = 0 if track is None or track.box is None or box is None else _drift(track.box, box)
    return Track(
        nodes, velocity, max(interval, 0.0), form.size, now, topology, form.hints, width, box, drift, area,
        found.track_id, found.log_depth, depth_rate,
    )  # fmt: skip


@compiled("(f8[:,::1], f8[:,::1], f8[::1], f8[::1], f8)")
def extrapolated(
    nodes: Array, velocity: Array, log_depth: Array, depth_rate: Array, ahead: float
) -> tuple[Array, Array, float]:
    """Return nodes ``(K, D)`` and log-depth, ``(K,)`` or ``(0,)``, after some seconds, and how far nodes move, RMS."""
    moved, deep, square = np.empty_like(nodes), log_depth.copy(), 0.0
    for k in range(len(nodes)):
        for d in range(nodes.shape[1]):
            moved[k, d] = nodes[k, d] + ahead * velocity[k, d]
            square += (ahead * velocity[k, d]) ** 2
    for k in range(len(depth_rate)):
        deep[k] += ahead * depth_rate[k]
    return moved, deep, math.sqrt(square / len(nodes))


@compiled("(f8[:,::1], f8[:,::1], f8[::1], f8[::1], f8, f8)")
def rates(
    nodes: Array, before: Array, log_depth: Array, log_depth_before: Array, seconds: float, turning: float
) -> tuple[Array, Array]:
    """Return how fast nodes ``(K, D)`` and log-depth have changed, units a second; ``(0,)`` if that is not known.

    Of their common motion along a closed curve the share ``turning`` is believed.
    """
    velocity, rate = np.empty_like(nodes), np.empty(min(len(log_depth), len(log_depth_before)))
    for k in range(len(nodes)):
        for d in range(nodes.shape[1]):
            velocity[k, d] = (nodes[k, d] - before[k, d]) / seconds
    for k in range(len(rate)):
        rate[k] = (log_depth[k] - log_depth_before[k]) / seconds
    return (velocity if turning == 1 else with_turning(nodes, velocity, turning)), rate


def _believed(change: float, seconds: float, model: MotionModel) -> float:
    """Return the part of a width's relative change that is not noise, limited by the time that has passed."""
    if abs(change) <= model.width_noise:
        return 0.0
    most = model.max_width_change * model.lasted(seconds)
    return max(-most, min(change, most))


def _drift(before: Window, after: Window) -> int:
    """Return by how much the edges of a box have moved, at most, pixels."""
    (a, b, c, d), (e, f, g, h) = before, after
    return max(abs(a - e), abs(b - f), abs(a + c - e - g), abs(b + d - f - h))
