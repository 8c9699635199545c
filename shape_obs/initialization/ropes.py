"""Every rope of a mask: strands joined over gaps where that is unambiguous, and why each one may be wrong."""

from __future__ import annotations

import math
from itertools import combinations
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.polyline import nearest_on
from shape_obs.image.find_region import find_region
from shape_obs.image.outline_tracing import SPECK
from shape_obs.image.region import Region
from shape_obs.initialization.appearance import Picture, look_of_end, misfit
from shape_obs.initialization.medial_axis import even, find_strands
from shape_obs.initialization.objects import SHORTEST_ROPE, SceneObject
from shape_obs.initialization.pairing import END, NARROW, ONTO, SURE, cheapest_pairing, lead, price_of, routes
from shape_obs.initialization.skeleton import MOST_BRANCHES
from shape_obs.initialization.strand_curves import Strand, join

Array = npt.NDArray[np.float64]

_NEAR: Final = 5.0  # widths beyond an end on another rope, in which a mask is looked at
_PINHOLE: Final = 0.8  # widths from a hole to the border if it is filled: in a strand 0.5, a crossing 0.7, a loop 1
_STICKS_OUT: Final = 1.5  # times as far as a rope's border, straight on, reaches a mask if something sticks out of it


def find_ropes(region: Region, picture: Picture | None = None, gap: float = NARROW) -> tuple[list[SceneObject], str]:
    """Return the ropes of a mask, longest first, and why there are none.

    Args:
        region: The mask of any number of ropes that may lie over each other.
        picture: ``(H, W, 3)`` RGB, in which ropes may have colours of their own; None without one.
        gap: How wide a gap between two pieces of a rope costs a nat, widths; one of three nats is bridged if straight.
    """
    strands, refusal = find_strands(_without_pinholes(region), picture, several=True)
    strands = [each for each in strands if each.length >= SHORTEST_ROPE * each.width]
    strands = _joined(strands, region, picture, gap)
    ropes = [_rope(strand, strands, region) for strand in strands]
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
    across = [len(_goes_on(away[i], widths[i], region)) if lies[i] else 0.0 for i in range(len(away))]
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


def _rope(strand: Strand, strands: list[Strand], region: Region) -> SceneObject:
    """Return one of all strands as a rope."""
    doubts = list(strand.doubts)
    ends = [strand.curve[:: 1 - 2 * e] for e in (0, 1) if strand.inside[e]]
    if any(_sticks_out(end, strand.width, strands, region) for end in ends):
        doubts.append("it ends on another rope, and something sticks out beyond it")
    if strand.closed:
        doubts.append("it is a closed ring: where it begins is unknown")
    hidden = ~region.carries(strand.curve)
    axis = FittedCurve.through(strand.curve, hidden, ambiguity="; ".join(dict.fromkeys(doubts)))
    return SceneObject(axis, strand.width)


def _goes_on(curve: Array, width: float, region: Region) -> Array:
    """Return the places of a mask straight on from a strand's first point, which lies on another rope: ``(P, 2)``."""
    ahead = -lead(curve, width).heading
    places = curve[0] + np.arange(_NEAR * width + 2)[:, None] * (ahead.real, ahead.imag)
    return places[: np.argmin(np.append(region.contains(places), False))]


def _sticks_out(curve: Array, width: float, strands: list[Strand], region: Region) -> bool:
    """Return whether a mask goes on beyond all ropes where a strand ends on another one."""
    last = _goes_on(curve, width, region)[-1:]
    near = ((nearest_on(other.curve, last)[1] <= _STICKS_OUT * other.width / 2).all() for other in strands)
    return not any(near)


def _without_pinholes(region: Region) -> Region:
    """Fill the holes of a mask that lie within one rope, or within the crossing of two.

    Each of them would make the rope two thin strands side by side.

    Args:
        region: The mask of any number of ropes.

    Returns:
        The mask without them; the region itself if there are none.
    """
    traced = region.traced
    width = traced.widths[traced.holes[:, 0].astype(np.intp)]
    some = (traced.holes[:, 3] >= SPECK) & (traced.holes[:, 5] < np.pi * (_PINHOLE * width) ** 2 + 1.0)
    if not some.any() or np.count_nonzero(some) > MOST_BRANCHES:
        return region
    mask, found = (region.mask > 0).astype(np.uint8), False
    left, top = region.window[:2]
    for hole, across in zip(traced.holes[some], width[some], strict=True):
        column, row = int(hole[1]) - left + 1, int(hole[2]) - top
        if mask[row, column]:
            continue
        box = cv2.floodFill(mask, None, (column, row), (2.0,), flags=4)[3]
        margin = int(across) + 2
        area = np.s_[
            max(box[1] - margin, 0) : box[1] + box[3] + margin, max(box[0] - margin, 0) : box[0] + box[2] + margin
        ]
        near = mask[area]
        inside = near == 2
        depth = cv2.distanceTransform((near > 0).view(np.uint8), cv2.DIST_L2, 5)
        fills = float(np.asarray(depth)[inside].max()) <= _PINHOLE * across
        near[inside] = 1 if fills else 0
        found |= fills
    return find_region(mask, region.window, 1, 0.0) if found else region
