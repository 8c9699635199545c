"""Every rope of a mask: strands joined over gaps where that is unambiguous, and why each one may be wrong."""

from __future__ import annotations

import math
from itertools import combinations
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.geometry.curve import FittedCurve
from shape_obs.image.region import Region
from shape_obs.initialization.appearance import Picture, look_of_end, misfit
from shape_obs.initialization.medial_axis import even, find_strands
from shape_obs.initialization.objects import SHORTEST_ROPE, SceneObject
from shape_obs.initialization.pairing import END, NARROW, ONTO, SURE, cheapest_pairing, lead, price_of, routes
from shape_obs.initialization.pinholes import without_pinholes
from shape_obs.initialization.strand_curves import Strand, join

Array = npt.NDArray[np.float64]

_NEAR: Final = 5.0  # widths beyond an end on another rope, in which a mask is looked at
_STICKS_OUT: Final = 1.5  # times as far as a rope's border, straight on, reaches a mask if something sticks out of it


def find_ropes(region: Region, picture: Picture | None = None, gap: float = NARROW) -> tuple[list[SceneObject], str]:
    """Return the ropes of a mask, longest first, and why there are none.

    Args:
        region: The mask of any number of ropes that may lie over each other.
        picture: ``(H, W, 3)`` RGB, in which ropes may have colours of their own; None without one.
        gap: How wide a gap between two pieces of a rope costs a nat, widths; one of three nats is bridged if straight.
    """
    strands, refusal = find_strands(without_pinholes(region), picture, several=True)
    strands = [each for each in strands if each.length >= SHORTEST_ROPE * each.width]
    ropes = [_rope(strand, region) for strand in _joined(strands, region, picture, gap)]
    if not ropes and not refusal:
        refusal = f"nothing in the mask is {SHORTEST_ROPE:.2g} times as long as it is wide"
    return sorted(ropes, key=lambda rope: -rope.curve.size), refusal


def _joined(strands: list[Strand], region: Region, picture: Picture | None, narrow: float) -> list[Strand]:
    """Join strands end to end, as is cheapest for all ends that compete, but only where that is sure.

    An end that lies on another rope goes on beyond that one, if a gap in the mask is what keeps the two apart: what
    lies on that rope is no gap.
    """
    away = [strand.curve[:: 1 - 2 * e] for strand in strands for e in (0, 1)]
    widths = [strand.width for strand in strands for _ in (0, 1)]
    lies = np.array([lies for strand in strands for lies in strand.inside], bool)
    across = [reach_beyond(away[i], widths[i], region)[0] if lies[i] else 0.0 for i in range(len(away))]
    price = np.full((len(away), len(away)), np.inf)
    np.fill_diagonal(price, np.where(lies, ONTO, END))
    gaps: dict[tuple[int, int], float] = {}
    for i, j in combinations([end for end in range(len(away)) if not strands[end // 2].closed], 2):
        gap = max(math.dist(away[i][0], away[j][0]) - across[i] - across[j], 0.0)
        gap /= narrow * max(widths[i], widths[j])
        if i // 2 != j // 2 and gap < price[i, i] + price[j, j] + SURE:
            gaps[i, j] = gap
    near = {end for pair in gaps for end in pair}
    leads = {end: lead(away[end], widths[end]) for end in near}
    looks = {end: look_of_end(away[end], widths[end], picture) for end in near}
    for (i, j), gap in gaps.items():
        bend = price_of(leads[i], leads[j], max(widths[i], widths[j]))
        price[i, j] = price[j, i] = gap + bend + misfit(looks[i], looks[j])
    partner, margin = cheapest_pairing(price)
    partner = np.where(margin < SURE, np.arange(len(partner)), partner)
    for route in routes(partner, range(len(strands))):
        if partner[route[0]] != route[0]:  # a ring is cut where that costs least
            weakest = min(route, key=lambda end: margin[end])
            partner[[weakest, partner[weakest]]] = weakest, partner[weakest]
    return [_chained(strands, route, margin) for route in routes(partner, range(len(strands)))]


def _chained(strands: list[Strand], route: list[int], margin: Array) -> Strand:
    """Return the strands of a route, each entered by one of its ends, as one; ``margin`` is that of all ends."""
    doubts = [doubt for end in route for doubt in strands[end // 2].doubts]
    if margin[[route[0], route[-1] ^ 1]].min() < SURE:
        doubts.append("it ends where another rope ends: the two may be one")
    pieces = [strands[end // 2] for end in route]
    if len(pieces) == 1:
        return pieces[0]._replace(doubts=tuple(doubts))
    width = max(piece.width for piece in pieces)
    curve, bridged = join([piece.curve[:: 1 - 2 * (end % 2)] for piece, end in zip(pieces, route, strict=True)], width)
    inside = pieces[0].inside[route[0] % 2], pieces[-1].inside[1 - route[-1] % 2]
    return Strand(even(curve, bridged, width)[0], width, inside, doubts=tuple(doubts))


def _rope(strand: Strand, region: Region) -> SceneObject:
    doubts = list(strand.doubts)
    ends = [strand.curve[:: 1 - 2 * e] for e in (0, 1) if strand.inside[e]]
    if any(reach_beyond(end, strand.width, region)[1] for end in ends):
        doubts.append("it ends on another rope, and something sticks out beyond it")
    if strand.closed:
        doubts.append("it is a closed ring: where it begins is unknown")
    hidden = ~region.carries(strand.curve)
    axis = FittedCurve.through(strand.curve, hidden, ambiguity="; ".join(dict.fromkeys(doubts)))
    return SceneObject(axis, strand.width)


def reach_beyond(curve: Array, width: float, region: Region) -> tuple[float, bool]:
    """Return how far a mask goes straight on where a strand ends on another rope, and whether it sticks out of that.

    Args:
        curve: ``(P, 2)`` pixels, from the end that lies on another rope.
        width: Of the strand, pixels.
        region: The mask.
    """
    ahead, reach = -lead(curve, width).heading, int(_NEAR * width) + 2
    column, row = int(curve[0, 0]) - region.window.left, int(curve[0, 1]) - region.window.top
    left, top = max(column - 2 * reach, 0), max(row - 2 * reach, 0)
    near = np.pad((region.mask[top : row + 2 * reach, left : column + 2 * reach] > 0).view(np.uint8), 1)
    depth = np.asarray(cv2.distanceTransform(near, cv2.DIST_L2, 5))
    start = curve[0] - (region.window.left + left - 1, region.window.top + top - 1)

    def deep(places: Array) -> Array:
        at = np.clip(np.rint(places).astype(np.intp), 0, np.array(depth.shape[::-1]) - 1)  # the frame is background
        return depth[at[:, 1], at[:, 0]].astype(np.float64)

    along = np.append(deep(start + np.arange(reach)[:, None] * ahead), 0.0)
    stop = int(np.argmin(along > 0))
    axis = int(np.argmax(along[: max(min(stop, int(2 * width) + 2), 1)]))
    # The other rope runs where the mask is thick to both sides; its border is a radius over the sine from its axis.
    angles = np.deg2rad(np.arange(0.0, 180.0, 6.0))
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    sides = [deep(start + axis * ahead + side * 2 * along[axis] * ways) for side in (-1, 1)]
    way = ways[np.argmax(sides[0] + sides[1])]
    sine = abs(float(ahead[0] * way[1] - ahead[1] * way[0]))
    return float(stop), bool((stop - axis) * sine > _STICKS_OUT * along[axis])
