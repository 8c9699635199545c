"""The medial axis: a rope's curve from tip to tip when there is no previous frame, over crossings and gaps."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.polyline import arc_length, interpolate
from shape_obs.image.outline_tracing import SPECK
from shape_obs.image.region import Component, Region
from shape_obs.image.roi import Window
from shape_obs.initialization.crossings import Strands, untangle
from shape_obs.initialization.folding import fold_outline, unexplained_share
from shape_obs.initialization.gaps import Bridged, bridge
from shape_obs.initialization.skeleton import skeleton_graph

Array = npt.NDArray[np.float64]

_POINTS: Final = (96, 256)
_SPACING: Final = 0.4  # of the points of a traced curve, in widths
# Of a simple ribbon: how far from the folded curve its outline may lie, in widths (it is half a width along the sides,
# 0.7 at square ends), and the share of it that may lie farther, because it is ragged.
_RIBBON: Final = (1.0, 0.03)
# A strand that ends on another one is left out as noise while no more of the skeleton than this is left out in all.
_UNEXPLAINED: Final = 0.1
# A rope that crosses itself ten times has 31 branches, and the work grows with their square.
_MOST_BRANCHES: Final = 60
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
    curve, bridged, doubt = trace(region)
    axis = FittedCurve.through(curve, bridged, ambiguity=doubt)
    return axis if region is observed else observed.lifted(axis)


class Trace(NamedTuple):
    """The axis of a rope.

    Args:
        curve: (P,2) pixels, image coordinates, from tip to tip (a width short of it, at most).
        bridged: (P,) bool, the points in gaps between pieces of the mask.
        doubt: Why the curve may be wrong, in words; empty where there is no reason to doubt it.
    """

    curve: Array
    bridged: npt.NDArray[np.bool_]
    doubt: str


def trace(region: Region) -> Trace:
    """Find the axis of a rope in its mask.

    A simple ribbon is folded; what crosses itself is thinned to a skeleton, and its strands strung together; the
    pieces of all components are joined end to end.

    Args:
        region: With one component or more.
    """
    folds = [(component, folded(component)) for component in region.components]
    ribbons = [(component, curve) for component, curve in folds if curve is not None]
    if len(ribbons) == len(region.components) == 1:
        curve = ribbons[0][1]
        return _doubted(curve, "")
    pieces = [curve for _, curve in ribbons]
    width = max((component.width for component, _ in ribbons), default=0.0)
    doubts: list[str] = []
    if len(ribbons) < len(region.components):
        skeleton = skeleton_graph(*_without(region, [component for component, _ in ribbons]))
        if len(skeleton.branches) > _MOST_BRANCHES:
            curve = fold_outline(region.components[0].outline, region.components[0].width)
            return _doubted(curve, f"the mask branches {len(skeleton.branches)} times: it is no rope")
        strands = untangle(skeleton)
        width = skeleton.width
        kept = _explained(strands)
        pieces += [strands.curves[i] for i in kept]
        doubts += _doubts(strands, kept, alone=len(region.components) == 1)
    if not pieces:
        curve = fold_outline(region.components[0].outline, region.components[0].width)
        return _doubted(curve, "the mask has no axis")
    joined = bridge(pieces, width)
    doubts += _doubts_of_gaps(joined)
    curve, bridged = _even(joined.curve, joined.bridged, width)
    return Trace(curve, bridged & ~region.contains(curve), "; ".join(dict.fromkeys(doubts)))


def folded(component: Component) -> Array | None:
    """Return the centreline of a component if it is a simple ribbon: no hole, and all of it near; else None."""
    if component.holes:
        return None
    outline, (near, ragged) = component.outline, _RIBBON
    curve = fold_outline(outline, component.width)
    return curve if unexplained_share(outline, curve, near * component.width) <= ragged else None


def _without(region: Region, ribbons: list[Component]) -> tuple[npt.NDArray[np.uint8], tuple[int, int]]:
    """Return the region's mask without some of its components, which have no holes, and without specks in the others.

    Cropped to those others, with the image coordinates of its first pixel.
    """
    others = np.concatenate([c.outline for c in region.components if not any(c is ribbon for ribbon in ribbons)])
    (left, top), (right, bottom) = others.min(axis=0).astype(int).tolist(), others.max(axis=0).astype(int).tolist()
    crop = Window(left - region.window.left, top - region.window.top, right - left + 1, bottom - top + 1)
    mask = region.mask[crop.slices].copy()
    outlines, tree = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    for outline, parent in zip(outlines, tree[0, :, 3], strict=True):
        if parent >= 0 and len(outline) < SPECK:
            cv2.drawContours(mask, [outline], -1, (255.0,), cv2.FILLED)
    drawn = [np.rint(component.outline - (left, top)).astype(np.int32) for component in ribbons]
    cv2.drawContours(mask, drawn, -1, (0.0,), cv2.FILLED)
    return mask, (left, top)


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
        doubts.append("the mask holds a closed ring: where the rope begins cannot be told")
    ends = sum(not inside for i in kept for inside in strands.inside[i])
    joints = sum(inside for i in kept for inside in strands.inside[i])
    if len(kept) > 1 and (alone or joints):
        doubts.append(f"the mask branches: {ends} free ends and {joints} that lie on another strand")
    return doubts


def _doubts_of_gaps(joined: Bridged) -> list[str]:
    if joined.rival < _RIVAL:
        return ["the pieces could be joined in another order about as well"]
    return []


def _doubted(curve: Array, doubt: str) -> Trace:
    """Return a folded curve."""
    return Trace(curve, np.zeros(len(curve), bool), doubt)


def _even(curve: Array, bridged: npt.NDArray[np.bool_], width: float) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return the curve at even steps, and which of its points lie in gaps."""
    curve = np.ascontiguousarray(curve)
    arc = arc_length(curve)
    at = np.linspace(0.0, arc[-1], int(np.clip(round(arc[-1] / (_SPACING * width)), *_POINTS)))
    nearest = np.clip(np.searchsorted(arc, at), 1, len(arc) - 1)
    return interpolate(curve, arc, at), bridged[nearest] | bridged[nearest - 1]
