"""The medial axis: a rope's curve from tip to tip when there is no previous frame, over crossings and gaps."""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.polyline import arc_length, interpolate
from shape_obs.image.outline_tracing import SPECK, fill_holes
from shape_obs.image.region import Component, Region
from shape_obs.initialization.crossings import Strands, untangle
from shape_obs.initialization.folding import fold_outline, unexplained_share
from shape_obs.initialization.gaps import bridge
from shape_obs.initialization.skeleton import skeleton_graph

Array = npt.NDArray[np.float64]

_POINTS: Final = (96, 256)
_SPACING: Final = 0.4  # of the points of a traced curve, in widths
# Of a simple ribbon: how far from the folded curve its outline may lie, in widths (it is half a width along the sides,
# 0.7 at square ends), and the share of it that may lie farther, because it is ragged.
_RIBBON: Final = (1.0, 0.03)
# A strand that ends on another one is left out as noise while no more of the skeleton than this is left out in all.
_UNEXPLAINED: Final = 0.1
_MOST_HOLES: Final = 300  # narrow ones among them, which noise makes; the loops of a rope are far fewer
# Another way to join the pieces that is dearer by this little is as likely.
_RIVAL: Final = 1.15


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
    axis = _axis_of_mask(region)
    return axis if region is observed else observed.lifted(axis)


def _axis_of_mask(region: Region) -> FittedCurve:
    """Return the axis of a rope in its mask.

    A simple ribbon is folded; what crosses itself is thinned to a skeleton, and its strands strung together; the pieces
    of all components are joined end to end.
    """
    folds = [(component, folded(component)) for component in region.components]
    ribbons = [component for component, curve in folds if curve is not None]
    pieces = [curve for _, curve in folds if curve is not None]
    if len(pieces) == len(folds) == 1:
        return _axis(pieces[0])
    largest, alone, doubts = region.components[0], len(folds) == 1, []
    width = max((component.width for component in ribbons), default=0.0)
    holes = int(np.count_nonzero(region.traced.holes[:, 3] >= SPECK))
    if holes > _MOST_HOLES:
        return _axis(fold_outline(largest.outline, largest.width), doubt=f"the mask has {holes} holes: it is no rope")
    if len(pieces) < len(folds):
        skeleton = skeleton_graph(_without(region, ribbons), region.window[:2])
        if skeleton.excess:
            return _axis(fold_outline(largest.outline, largest.width), doubt=f"{skeleton.excess}: it is no rope")
        strands = untangle(skeleton)
        kept, width = _explained(strands), skeleton.width
        pieces += [strands.curves[i] for i in kept]
        doubts = _doubts(strands, kept, alone=alone)
    if not pieces:
        return _axis(fold_outline(largest.outline, largest.width), doubt="the mask has no axis")
    joined = bridge(pieces, width)
    if joined.rival < _RIVAL:
        doubts.append("the pieces could be joined in another order about as well")
    curve, bridged = _even(joined.curve, joined.bridged, width)
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


def _explained(strands: Strands) -> list[int]:
    """Return the strands that are the rope: without the short ones that end on another, a tenth of all at most."""
    length = [float(arc_length(np.ascontiguousarray(curve))[-1]) for curve in strands.curves]
    spare = _UNEXPLAINED * sum(length)
    kept = list(range(len(length)))
    for i in sorted(kept, key=lambda i: length[i]):
        if any(strands.inside[i]) and len(kept) > 1 and length[i] <= spare:
            spare -= length[i]
            kept.remove(i)
    return kept


def _doubts(strands: Strands, kept: list[int], *, alone: bool) -> list[str]:
    """Return why the strands of a skeleton may not be those of one rope; ``alone`` if there is nothing but them."""
    doubts = list(strands.doubts)
    if strands.rings:
        doubts.append("the mask holds a closed ring: where the rope begins is unknown")
    ends = sum(not inside for i in kept for inside in strands.inside[i])
    joints = sum(inside for i in kept for inside in strands.inside[i])
    if len(kept) > 1 and (alone or joints):
        doubts.append(f"the mask branches: {ends} free ends and {joints} that lie on another strand")
    return doubts


def _even(curve: Array, bridged: npt.NDArray[np.bool_], width: float) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return the curve at even steps, and which of its points lie in gaps."""
    curve = np.ascontiguousarray(curve)
    arc = arc_length(curve)
    at = np.linspace(0.0, arc[-1], int(np.clip(round(arc[-1] / (_SPACING * width)), *_POINTS)))
    nearest = np.clip(np.searchsorted(arc, at), 1, len(arc) - 1)
    return interpolate(curve, arc, at), bridged[nearest] | bridged[nearest - 1]
