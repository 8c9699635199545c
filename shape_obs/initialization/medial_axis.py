"""The medial axis: a rope's curve from tip to tip when there is no previous frame, over crossings and gaps."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.polyline import arc_length, interpolate
from shape_obs.image.outline_tracing import SPECK, fill_holes
from shape_obs.image.region import Component, Region
from shape_obs.initialization.crossings import Evidence, untangle
from shape_obs.initialization.folding import closest_sides, fold_outline, unexplained_share
from shape_obs.initialization.gaps import bridge, cheapest_order, first_chord, hermite
from shape_obs.initialization.skeleton import middle_value, skeleton_graph, trace_skeleton
from shape_obs.initialization.strand_curves import joint, middle_part, smooth_curve
from shape_obs.initialization.thinning import thin_pixels

Array = npt.NDArray[np.float64]

_POINTS: Final = (96, 256)
_SPACING: Final = 0.4  # of the points of a traced curve, in widths
# Of a simple ribbon: how far from the folded curve its outline may lie, in widths (it is half a width along the sides,
# 0.7 at square ends), and the share of it that may lie farther, because it is ragged.
_RIBBON: Final = (1.0, 0.03)
# A strand that ends on another one is left out as noise while no more of the skeleton than this is left out in all.
_UNEXPLAINED: Final = 0.1
_BUMP: Final = 0.65  # widths by which a bump sticks out of one of several ropes
_MOST_HOLES: Final = 300  # narrow ones among them, which noise makes; the loops of a rope are far fewer
# Another way to join the pieces that is dearer by this little is as likely.
_RIVAL: Final = 1.15
_TURNS_BACK: Final = 1.8  # rad^2, see ``bending``: an arc of 155 degrees over a wide gap

#: The compiled functions that finding an axis in a mask may call.
AXIS_FUNCTIONS: Final = (
    closest_sides, unexplained_share, fill_holes, thin_pixels, trace_skeleton, middle_value, smooth_curve, middle_part,
    joint, first_chord, hermite, cheapest_order,
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


class Strand(NamedTuple):
    """A piece of rope that goes on straight over all crossings, from where it begins to where it ends.

    Args:
        curve: ``(P, 2)`` pixels at even steps, in no particular direction.
        width: Pixels.
        inside: Whether its first and its last end lie on another strand, instead of freely.
        closed: Whether it is a ring, cut open somewhere.
        doubts: Why it may be wrong, in words.
    """

    curve: Array
    width: float
    inside: tuple[bool, bool] = (False, False)
    closed: bool = False
    doubts: tuple[str, ...] = ()

    @property
    def length(self) -> float:
        """The length, pixels."""
        return float(arc_length(np.ascontiguousarray(self.curve))[-1])


def find_strands(region: Region, evidence: Evidence | None = None) -> tuple[list[Strand], str]:
    """Return the strands of all components of a mask: simple ribbons are folded, the others thinned to a skeleton.

    Args:
        region: The mask.
        evidence: By what several ropes differ; None if all strands are of one rope.

    Returns:
        The strands, and why the mask shows no ropes; one of the two is empty.
    """
    folds = [(component, folded(component)) for component in region.components]
    ribbons = [component for component, curve in folds if curve is not None]
    strands = [Strand(curve, component.width) for component, curve in folds if curve is not None]
    if len(strands) == len(folds):
        return strands, ""
    holes = int(np.count_nonzero(region.traced.holes[:, 3] >= SPECK))
    if holes > _MOST_HOLES:
        return [], f"the mask has {holes} holes: it is no rope"
    skeleton = skeleton_graph(_without(region, ribbons), region.window[:2], _BUMP if evidence is not None else 0.0)
    if skeleton.excess:
        return [], f"{skeleton.excess}: it is no rope"
    for curve, width, inside, closed, doubts in zip(*untangle(skeleton, evidence), strict=True):
        evened = even(curve, np.zeros(len(curve), bool), width)[0]
        strands.append(Strand(evened, width, inside, closed, doubts))
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
    joined = bridge([strand.curve for strand in kept], width)
    if joined.rival < _RIVAL:
        doubts.append("the pieces could be joined in another order about as well")
    if region.pieces > 1 and joined.bent > _TURNS_BACK:
        doubts.append("it would have to turn back where it is hidden: these may be two ropes, which count=2 finds")
    curve, bridged = even(joined.curve, joined.bridged, width)
    return _axis(curve, bridged & ~region.contains(curve), "; ".join(dict.fromkeys(doubts)))


def _axis(curve: Array, bridged: npt.NDArray[np.bool_] | None = None, doubt: str = "") -> FittedCurve:
    """Return an axis from tip to tip (a width short of it, at most), and why it may be wrong."""
    return FittedCurve.through(curve, np.zeros(len(curve), bool) if bridged is None else bridged, ambiguity=doubt)


def folded(component: Component) -> Array | None:
    """Return the centreline of a component if it is a simple ribbon: no hole, and all of it near; else None."""
    if component.holes:
        return None
    outline, (near, ragged) = component.outline, _RIBBON
    curve = fold_outline(outline, component.width)
    return curve if unexplained_share(outline, curve, near * component.width) <= ragged else None


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
    at = np.linspace(0.0, arc[-1], int(np.clip(round(arc[-1] / (_SPACING * width)), *_POINTS)))
    nearest = np.clip(np.searchsorted(arc, at), 1, len(arc) - 1)
    return interpolate(curve, arc, at), bridged[nearest] | bridged[nearest - 1]
