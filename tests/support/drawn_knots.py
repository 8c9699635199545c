"""Draw ropes of which it is known whether they are knotted, from braids that are closed, swirled and cut open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from shape_obs.geometry.crossings import Crossing
from shape_obs.geometry.intersections import find_crossings
from shape_obs.geometry.polyline import arc_length, interpolate

Array = npt.NDArray[np.float64]

#: Words of braids whose closures are these knots: letter i crosses strands i and i + 1, -i with the other one above.
#: Those of prime knots are from V. F. R. Jones, "Hecke Algebra Representations of Braid Groups", 1987, table 15.1.
KNOTS: Final[dict[str, tuple[int, ...]]] = {
    "trefoil": (1, 1, 1),
    "figure eight": (1, -2, 1, -2),
    "5_1": (1, 1, 1, 1, 1),
    "5_2": (1, 1, 1, 2, -1, 2),
    "6_2": (-1, 2, -1, 2, 2, 2),
    "6_3": (-1, -1, 2, -1, 2, 2),
    "8_19": (1, 1, 1, 2, 1, 1, 1, 2),
    "granny": (1, 1, 1, 2, 2, 2),
    "square": (1, 1, 1, -2, -2, -2),
}
UNKNOTS: Final[dict[str, tuple[int, ...]]] = {
    "loop": (1,),
    "two loops": (1, -2),
    "slack figure eight": (1, -2, 1, 2),
    "slack trefoil": (1, 1, -1),
    "slack square": (1, 1, -1, 2, -2, 2),
    "coil": (1, 2, 3),
    "slack braid": (1, 2, -2, -1, 1, 2),
}
_STEPS: Final = 60  # points of the closed curve between two letters of a braid
_MOST: Final = 24  # crossings of a drawing
# Strands that cross lie so far from each other along the image, in pixels, and along the line of sight, as a share of
# the drawing's height.
_APART: Final = 2.0
_CLEARANCE: Final = 0.002


@dataclass(frozen=True)
class DrawnKnot:
    """A drawn rope that may be knotted.

    Args:
        name: Of the knot, a key of ``KNOTS`` or ``UNKNOTS``.
        curve: ``(P, 2)`` pixels, from end to end.
        heights: ``(P,)`` towards the camera, in pixels.
        knotted: Whether the rope is knotted when both ends are lifted towards the camera.
    """

    name: str
    curve: Array
    heights: Array
    knotted: bool


def drawn_knot(rng: np.random.Generator, name: str, swirls: int = 3) -> DrawnKnot:
    """Draw a knot or unknot as a rope that is cut open at its highest place.

    The closed curve is swirled, which moves space and leaves the knot what it is, looked at from any side, and cut
    where it is nearest to the camera. The ends are then laid over the rope, each above everything before.
    """
    for _ in range(2000):
        closed = _braid_closure({**KNOTS, **UNKNOTS}[name])
        for _ in range(swirls):
            closed = _swirled(closed, rng)
        closed = closed @ np.linalg.qr(rng.normal(size=(3, 3)))[0] * rng.choice([-1, 1], size=3)
        opened = np.roll(closed, -int(np.argmax(closed[:, 2])), axis=0)
        rope = _placed(_with_tails(opened, rng), rng)
        crossings = with_heights(find_crossings([rope[:, :2]], [name]), [rope[:, :2]], [rope[:, 2]], [name])
        if len(crossings) <= _MOST and _is_clear(rope, crossings):
            return DrawnKnot(name, rope[:, :2], rope[:, 2], name in KNOTS)
    raise RuntimeError(f"no drawing of {name!r} found with at most {_MOST} clear crossings.")


def with_heights(
    crossings: Sequence[Crossing], curves: Sequence[Array], heights: Sequence[Array], names: Sequence[str]
) -> tuple[Crossing, ...]:
    """Return crossings with the strand above that is higher there."""
    found = []
    for crossing in crossings:
        slots = zip(map(list(names).index, crossing.slots), crossing.arcs, strict=True)
        low, high = (_height_at(curves[k], heights[k], share) for k, share in slots)
        found.append(crossing._replace(above=int(high > low)))
    return tuple(found)


def _height_at(curve: Array, heights: Array, share: float) -> float:
    """Return the height at a share of the length of a curve in the image."""
    arc = arc_length(np.ascontiguousarray(curve, dtype=np.float64))
    return float(np.interp(share * arc[-1], arc, heights))


def _braid_closure(word: Sequence[int]) -> Array:
    """Return the closure of a braid, which has one component, as a closed curve: ``(P, 3)``, around the third axis."""
    count = max(map(abs, word)) + 1
    along = np.arange(_STEPS) / _STEPS
    rows, at = [], 0
    for _ in range(count):
        for n, letter in enumerate(word):
            i = abs(letter) - 1
            to = {i: i + 1, i + 1: i}.get(at, at)
            bulge = 0.0 if to == at else np.sign(letter) * (1 if at == i else -1)
            angle = 2 * np.pi * (n + along) / len(word)
            radius = count + at + (to - at) * (1 - np.cos(np.pi * along)) / 2
            height = bulge * np.sin(np.pi * along) / 2
            rows.append(np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1))
            at = to
    return np.concatenate(rows)


def _swirled(curve: Array, rng: np.random.Generator) -> Array:
    """Return a curve after a turn of space around a random axis, less the further from a random point.

    Each sphere around the point is turned as a whole, so that no strand passes through another.
    """
    size = np.ptp(curve, axis=0).max()
    from_centre = curve - (curve.mean(axis=0) + rng.normal(size=3) * size / 4)
    axis = rng.normal(size=3)
    distance = np.linalg.norm(from_centre, axis=1)
    angle = rng.uniform(-2.5, 2.5) * np.exp(-((distance / (0.4 * size)) ** 2))[:, None]
    return Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).apply(from_centre)


def _is_clear(rope: Array, crossings: Sequence[Crossing]) -> bool:
    """Return whether the crossings of a rope, ``(P, 3)``, lie apart, and their strands one above the other."""
    places = np.array([crossing.pixel for crossing in crossings]).reshape(-1, 2)
    distance = np.linalg.norm(places[:, None] - places[None], axis=2)[np.triu_indices(len(places), 1)]
    curve, heights = rope[:, :2], rope[:, 2]
    shares = sorted(share for crossing in crossings for share in crossing.arcs)
    steps = np.diff([0.0, *shares, 1.0]) * np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()
    gaps = [abs(_height_at(curve, heights, c.arcs[0]) - _height_at(curve, heights, c.arcs[1])) for c in crossings]
    return min(*steps, *distance) > _APART and min(gaps, default=np.inf) > _CLEARANCE * np.ptp(heights)


def _with_tails(rope: Array, rng: np.random.Generator) -> Array:
    """Return a rope whose ends, at its highest place, go on above everything, one above the other."""
    size, top = np.ptp(rope, axis=0).max(), rope[:, 2].max()
    tails = []
    for level, (end, before) in enumerate(((rope[0], rope[3]), (rope[-1], rope[-4])), 1):
        step = rng.uniform(0.2, 0.8) * size / 100
        turn = np.arctan2(*(end - before)[1::-1]) + np.cumsum(np.full(100, rng.uniform(-3, 3) / 100))
        flat = end[:2] + step * np.cumsum(np.stack([np.cos(turn), np.sin(turn)], axis=1), axis=0)
        rise = top + 0.1 * size * level * np.minimum(np.arange(1, 101) / 5, 1.0)
        tails.append(np.column_stack([flat, rise]))
    return np.concatenate([tails[0][::-1], rope, tails[1]])


def _placed(rope: Array, rng: np.random.Generator) -> Array:
    """Return a rope moved and scaled into an image of 640 x 480, with points at equal steps in the image."""
    room = np.array([640.0, 480.0]) - 40.0
    rope = rope * (room / np.ptp(rope[:, :2], axis=0)).min()
    rope[:, :2] += 20.0 - rope[:, :2].min(axis=0)
    rope[:, :2] += rng.uniform(size=2) * (room - np.ptp(rope[:, :2], axis=0))
    arc = arc_length(np.ascontiguousarray(rope[:, :2]))
    return interpolate(np.ascontiguousarray(rope), arc, np.linspace(0.0, arc[-1], 900))
