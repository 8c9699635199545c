"""The medial axis: a rope's curve from tip to tip when there is no previous frame, over crossings and gaps."""

from __future__ import annotations

from itertools import combinations
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.polyline import arc_length, interpolate
from shape_obs.image.outline_tracing import SPECK, fill_holes
from shape_obs.image.region import Component, Region
from shape_obs.initialization.appearance import Picture
from shape_obs.initialization.crossings import untangle
from shape_obs.initialization.folding import AXIS_POINTS, closest_sides, fold_outline, unexplained_share
from shape_obs.initialization.pairing import (
    NARROW,
    SURE,
    bending,
    cheapest_order,
    cheapest_pairing,
    first_chord,
    lead,
    price_of,
    routes,
)
from shape_obs.initialization.skeleton import MOST_OF_NOISE, middle_value, skeleton_graph, trace_skeleton
from shape_obs.initialization.strand_curves import (
    Strand,
    hermite,
    join,
    joint,
    middle_part,
    smooth_curve,
    without_ragged_ends,
)
from shape_obs.initialization.thinning import thin_pixels

Array = npt.NDArray[np.float64]

_SPACING: Final = 0.4  # widths from point to point of a traced curve: less than a ribbon's radius, see ``share_pixels``
_RAGGED: Final = 0.03  # share of a ribbon's outline that may lie over a width from its axis; square ends have 0.7
_UNEXPLAINED: Final = 0.1  # share of all strands that is left out as noise, of those that end on another one
_BUMP: Final = 0.65  # widths that a bump sticks out of one of several ropes, where a longer one is an end of another
_WIDE: Final = 5.0  # widths of a gap that is too wide to be noise: a rope may turn back in a narrower one
_TURNS_BACK: Final = 1.8  # rad^2, see ``bending``: an arc of 155 degrees, which rather shows two ropes

#: The compiled functions that finding an axis in a mask may call.
AXIS_FUNCTIONS: Final = (
    closest_sides, unexplained_share, fill_holes, thin_pixels, trace_skeleton, middle_value, smooth_curve, middle_part,
    joint, first_chord, hermite, cheapest_order, cheapest_pairing,
)  # fmt: skip


def medial_axis(observed: Any) -> FittedCurve:
    """Return the axis of a rope from tip to tip, in no particular direction, without any previous frame.

    A mask is folded, or thinned to a skeleton; a cloud is cut into slices of equal geodesic distance; a cloud under a
    mask takes the mask's axis and puts it in space.

    Args:
        observed: A region or a cloud.
    """
    region = observed.parts[-1]
    if region.dimension == 3:
        return observed.axis()
    axis = region.axis or _axis_of_mask(region)
    return axis if region is observed else observed.lifted(axis)


def find_strands(region: Region, picture: Picture | None = None, *, several: bool = False) -> tuple[list[Strand], str]:
    """Return the strands of all components of a mask: simple ribbons are folded, the others thinned to a skeleton.

    Args:
        region: The mask.
        picture: ``(H, W, 3)`` RGB, in which ropes may have colours of their own; None without one.
        several: Whether the strands are of several ropes.

    Returns:
        The strands, and why the mask shows no ropes; one of the two is empty.
    """
    folds = [(component, folded(component)) for component in region.components]
    ribbons = [component for component, curve in folds if curve is not None]
    strands = [Strand(curve, component.width) for component, curve in folds if curve is not None]
    if len(strands) == len(folds):
        return strands, ""
    holes = int(np.count_nonzero(region.traced.holes[:, 3] >= SPECK))
    if holes > MOST_OF_NOISE:
        return [], f"the mask has {holes} holes: it is no rope"
    skeleton = skeleton_graph(_without(region, ribbons), region.window[:2], _BUMP if several else 0.0)
    if skeleton.excess:
        return [], f"{skeleton.excess}: it is no rope"
    for strand in untangle(skeleton, picture, several=several):
        evened = even(strand.curve, np.zeros(len(strand.curve), bool), strand.width)[0]
        strands.append(strand._replace(curve=evened))
    return strands, "" if strands else "the mask has no axis"


def _axis_of_mask(region: Region) -> FittedCurve:
    """Return the axis of a rope in its mask: its strands joined end to end."""
    strands, refusal = find_strands(region)
    if refusal:
        largest = region.components[0]
        return _axis(fold_outline(largest.outline, largest.width), doubt=refusal)
    kept = _explained(strands)
    doubts = _doubts(strands, kept, alone=region.pieces == 1)
    if len(kept) == 1:
        return _axis(kept[0].curve, doubt="; ".join(dict.fromkeys(doubts)))
    width = max(strand.width for strand in kept)
    joined, sure, bent = _in_order([strand.curve for strand in kept], width)
    if not sure:
        doubts.append("the pieces could be joined in another order about as well")
    if region.pieces > 1 and bent > _TURNS_BACK:
        doubts.append("it would have to turn back where it is hidden: these may be two ropes, which count=2 finds")
    curve, bridged = even(*join(joined, width), width)
    return _axis(curve, bridged & ~region.contains(curve), "; ".join(dict.fromkeys(doubts)))


def _in_order(pieces: list[Array], width: float) -> tuple[list[Array], bool, float]:
    """Return the pieces of a rope as they follow each other, by the short and straight gaps overall.

    Args:
        pieces: ``(P_i, 2)`` curves, pixels, in no particular direction.
        width: Of the rope, pixels.

    Returns:
        The pieces, each in its direction; whether every other order that differs in a gap is clearly dearer; what a
        bridge over a wide gap bends at most, see ``bending``.
    """
    ends = [without_ragged_ends(piece, width)[:: 1 - 2 * e] for piece in pieces for e in (0, 1)]
    leads, tips = [lead(end, width) for end in ends], np.array([end[0] for end in ends])
    gap = np.linalg.norm(tips[:, None] - tips, axis=2) / width  # (2n, 2n)
    price = gap / NARROW
    np.fill_diagonal(price, np.inf)
    for p, q in combinations(range(len(ends)), 2):
        price[p, q] += price_of(leads[p], leads[q], width) if p // 2 != q // 2 else np.inf
        price[q, p] = price[p, q]
    partner, margin = cheapest_order(price)
    wide = (gap > _WIDE)[np.arange(len(ends)), partner]  # (2n,) whether the gap behind an end is
    bent = max((bending(leads[end], leads[partner[end]]) for end in np.flatnonzero(wide)), default=0.0)
    (route,) = routes(partner, range(len(pieces)))
    return [pieces[end // 2][:: 1 - 2 * (end % 2)] for end in route], bool(margin.min() >= SURE), bent


def _axis(curve: Array, bridged: npt.NDArray[np.bool_] | None = None, doubt: str = "") -> FittedCurve:
    """Return an axis from tip to tip (a width short of it, at most), and why it may be wrong."""
    return FittedCurve.through(curve, np.zeros(len(curve), bool) if bridged is None else bridged, ambiguity=doubt)


def folded(component: Component) -> Array | None:
    """Return the centreline of a component if it is a simple ribbon: no hole, and all of it near; else None."""
    if component.holes:
        return None
    curve = fold_outline(component.outline, component.width)
    return curve if unexplained_share(component.outline, curve, component.width) <= _RAGGED else None


def _without(region: Region, ribbons: list[Component]) -> npt.NDArray[np.uint8]:
    """Return a region's mask without some of its components, which have no holes, and without specks in the others."""
    mask, (left, top) = region.mask.copy(), region.window[:2]
    fill_holes(mask, region.runs, region.traced.holes, left, top, SPECK, -1.0)
    drawn = [np.rint(component.outline - (left, top)).astype(np.int32) for component in ribbons]
    cv2.drawContours(mask, drawn, -1, (0.0,), cv2.FILLED)
    return mask


def _explained(strands: list[Strand]) -> list[Strand]:
    """Return the strands that are the rope: without the short ones that end on another, a tenth of all at most."""
    spare, kept = _UNEXPLAINED * sum(strand.length for strand in strands), list(strands)
    for strand in sorted(strands, key=lambda strand: strand.length):
        if any(strand.inside) and len(kept) > 1 and strand.length <= spare:
            spare -= strand.length
            kept = [other for other in kept if other is not strand]
    return kept


def _doubts(strands: list[Strand], kept: list[Strand], *, alone: bool) -> list[str]:
    """Return why strands may not be those of one rope; ``alone`` if there is nothing but them."""
    doubts = [doubt for strand in strands for doubt in strand.doubts]
    if any(strand.closed for strand in strands):
        doubts.append("the mask holds a closed ring: where the rope begins is unknown")
    inside = [end for strand in kept for end in strand.inside]
    if len(kept) > 1 and (alone or any(inside)):
        free = len(inside) - sum(inside)
        doubts.append(f"the mask branches: {free} free ends and {sum(inside)} that lie on another strand")
    return doubts


def even(curve: Array, bridged: npt.NDArray[np.bool_], width: float) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return the curve at even steps, and which of its points lie in gaps."""
    curve = np.ascontiguousarray(curve)
    arc = arc_length(curve)
    at = np.linspace(0.0, arc[-1], max(round(arc[-1] / (_SPACING * width)), AXIS_POINTS))
    nearest = np.clip(np.searchsorted(arc, at), 1, len(arc) - 1)
    return interpolate(curve, arc, at), bridged[nearest] | bridged[nearest - 1]
