"""Step: one frame of a rope in one compiled call, from what is seen to its state.

A rope is predicted, measured, registered, completed and judged, and its track advances. Every frame of it goes this
way, the first one too, which starts from an initial axis, with nothing known of the rope.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.geometry.curve import first_coordinates, with_log_depth
from shape_obs.geometry.polyline import arc_length, even_points, interpolate
from shape_obs.geometry.topology import from_tip_to_tip
from shape_obs.tracking.complete_chain import complete_chain
from shape_obs.tracking.judge_chain import judge_chain
from shape_obs.tracking.measure_chain import fit_chain_in_mask
from shape_obs.tracking.model import ChainConstants, Model  # noqa: F401 - the first in signatures
from shape_obs.tracking.occluders import UNKNOWN
from shape_obs.tracking.predict import BEFORE_TYPE, Before, advance, counted, predict
from shape_obs.tracking.register_chain import register_chain
from shape_obs.tracking.scene import MASK_TYPE, InMask
from shape_obs.tracking.state import RopeState, State  # noqa: F401 - the first in a signature

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
#: A track after a frame, see ``Track``: state, nodes, velocity, log-depth and how fast it changes. And the whole curve:
#: points ``(P, D)``, flags, arc length, metres, pixels and log-depth, ``(P,)``, the last three ``(0,)`` where they are
#: not known.
Stepped = tuple[State, Array, Array, Array, Array, Array, Flags, Array, Array, Array, Array]
#: A curve through a cloud, from tip to tip, ``(P, 3)``; where it does not lie on what is seen ``(P,)``; the mean square
#: distance of the points from it; their width; their resolution.
InCloud = tuple[Array, Flags, float, float, float]

_CLOUD_TYPE: Final = "Tuple((f8[:,::1], b1[::1], f8, f8, f8))"
NO_CLOUD: Final[InCloud] = np.zeros((0, 2)), np.zeros(0, bool), 0.0, 0.0, 1.0  # the resolution of a mask is a pixel

_FEWEST: Final = 6  # nodes of a visible piece
_MAX_CELL: Final = 24  # pixels: the edge of a cell of a very wide rope
_MAX_CELLS: Final = 4096  # about; more change nothing and cost time


@compiled(
    f"({MASK_TYPE}, {_CLOUD_TYPE}, i8, f8[:,::1], f8, f8, b1, {BEFORE_TYPE.format('RopeState')}, ChainConstants[::1])"
)
def step_chain(
    image: InMask, cloud: InCloud, area: int, start: Array, width: float, off: float, in_metres: bool,
    before: Before, model: Model,
) -> Stepped:  # fmt: skip
    """Follow a rope into a frame, or find it there: predict, measure, register, complete and judge it.

    Args:
        image: The mask; ``NO_MASK`` if there is a cloud.
        cloud: The cloud; ``NO_CLOUD`` if there is a mask.
        area: Of what is seen, pixels or points.
        start: ``(K, D)`` nodes of an initial axis; ``(0, 2)`` starts from where the rope is predicted. In a cloud they
            only say how many nodes a track begins with.
        width: Of the rope, pixels; 0 in a cloud.
        off: The share of the curve that may be bridged or hidden.
        in_metres: Whether the rope's points lie at equal steps in space.
        before: The track; without nodes at a cold start.
        model: ``(1,)`` the constants.
    """
    mask, runs, _, window, box, edge, depth, lens = image
    points, flags, spread, breadth, resolution = cloud
    known, last, velocity, deep_before, depth_rate, _, stamp, lost, reach = before
    constants, was, cold, nothing = model[0], known[0], len(last) == 0, lens[:0]

    nodes, node_log_depth, motion = predict(
        last, velocity, deep_before, depth_rate, stamp - was.stamp, was.interval, constants.velocity_share
    )
    seconds = np.inf if cold else stamp - was.stamp
    lasted = 0.0 if cold else counted(seconds, constants)
    expected = width, resolution, 1.0 if lost else 0.0, motion, seconds, lasted, reach

    arc, metres, log_depth, spurious, seen_area = arc_length(points), nothing, nothing, 0.0, 0.0
    ends, shapes = (UNKNOWN, UNKNOWN), np.empty((0, 2))
    if len(points) == 0:
        deep, sigmas, seen_area = nothing, _as_array(constants.sigmas_initial), float(area)
        if len(start) == 0:
            start, deep = visible_nodes(nodes, node_log_depth if len(lens) > 0 else nothing, known)
            # What comes to light, or under a hand, changes the area first.
            steady = abs(area - was.area) <= constants.steady * was.area
            sigmas = _as_array(constants.sigmas_steady) if steady else _as_array(constants.sigmas_changed)
        cell = max(int(min(width / 3, _MAX_CELL)), int(math.sqrt(area // _MAX_CELLS)), 1)  # thin ropes keep it
        points, arc, flags, metres, log_depth, spread, spurious, ends, shapes = fit_chain_in_mask(
            runs, mask, window[:2], start, deep, sigmas, cell, width, depth, lens, edge, constants
        )

    state, points, arc, flags, metres, log_depth = register_chain(
        points, arc, flags, metres, log_depth, ends, shapes, known, expected, nodes, node_log_depth, last, constants
    )

    now, pixels = state[0], nothing
    if not now.plain:
        points, arc, flags, metres, pixels, log_depth = complete_chain(
            points, arc, flags, metres, log_depth, known, state, was.width, lasted, nodes,
            node_log_depth, constants,
        )  # fmt: skip
    stations = metres if len(metres) > 0 else pixels if len(pixels) > 0 else arc
    _show(now, stations)
    found = even_points(points, stations, len(start) if cold else len(nodes), True)
    deep, now.steep = log_depth, 1.0
    if len(log_depth) > 0:
        deep = even_points(log_depth.reshape(-1, 1), stations, len(found), True).reshape(len(found))
        now.steep = arc_length(with_log_depth(points, log_depth))[-1] / max(arc[-1], 1e-9)

    begins = cold or (lost and max(now.hidden[0], now.hidden[1]) <= now.tolerance)
    judge_chain(
        was, now, points, arc, flags, metres, log_depth, spread, breadth, width, seen_area, off, spurious, begins,
        in_metres and not cold, constants,
    )  # fmt: skip
    now.area = 0 if flags.any() else area
    velocity, depth_rate = advance(
        was, now, found, last, deep, deep_before, stamp, arc[-1], now.seen_width, box, 1.0, constants,
    )  # fmt: skip
    return state, found, velocity, deep, depth_rate, points, flags, arc, metres, pixels, log_depth


@compiled
def _as_array(values: Any) -> Array:
    """Return several values of a constant as an array."""
    out = np.empty(len(values))
    for k in range(len(values)):
        out[k] = values[k]
    return out


@compiled("(f8[:,::1], f8[::1], RopeState[::1])")
def visible_nodes(nodes: Array, log_depth: Array, known: State) -> tuple[Array, Array]:
    """Return the predicted nodes ``(K, D)`` of the visible piece of a rope, about as far apart, and their log-depth."""
    if not known[0].hides:
        return nodes, log_depth
    rope, share = from_tip_to_tip(with_log_depth(nodes, log_depth) if len(log_depth) > 0 else nodes)
    head, tail, size = known[0].hidden[0], known[0].hidden[1], nodes.shape[1]
    count = max(int(np.rint(len(nodes) * (1 - head - tail))), _FEWEST)
    at = np.empty(count)
    for k in range(count):
        at[k] = head + (k + 0.5) / count * (1 - tail - head)
    found = interpolate(rope, share, at)
    if len(log_depth) == 0:
        return found, log_depth
    deep = np.empty(count)
    for k in range(count):
        deep[k] = found[k, size]
    return first_coordinates(found, size), deep


@compiled
def _show(now: Any, stations: Array) -> None:
    """Note the piece of a curve over which points are spread: without what may be hidden by noise alone.

    Of an end that something hides, two thirds of what may be noise elsewhere.

    Args:
        now: What is known of the rope.
        stations: ``(P,)`` how far along it the points of its curve lie.
    """
    now.shown[0], now.shown[1] = 0, len(stations)
    if not now.hides:
        return
    for end in range(2):
        hidden, least = now.hidden[end], now.tolerance * (2 / 3 if now.occluded[end] else 1)
        if hidden < least:
            at = 1 - hidden + 1e-9 if end else hidden - 1e-9
            now.shown[end] = np.searchsorted(stations, at * stations[-1])
