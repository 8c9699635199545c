"""From pixels to metres: robust local depth under each point of a form."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics
from shape_obs.compiled import compiled
from shape_obs.frame import DepthImages
from shape_obs.geometry.curve import FittedCurve, FittedForm
from shape_obs.geometry.lattice import FittedLattice
from shape_obs.image.region import Region
from shape_obs.point_cloud.local_depth import MAX_REACH, MIN_SHARE, median, median_depth, room

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

SMEARED: Final = 2.5  # widths next to a hidden piece, in which depth may be that of what hides it
COMPARED: Final = 6.0  # widths within which the rope's own depth is looked for
STEP: Final = 0.015  # metres: no rope on a table comes nearer by this much within a few widths


def form_depth(form: FittedForm, depth: DepthImages, region: Region, width: float) -> Array:
    """Return ``(P,)`` metres under a form, NaN where it is not known or belongs to something that lies over it.

    Under a lattice every third row and column is read.

    Looks at the middle half of the object's width (13 pixels at most), so that a round rope's flanks do not pull the
    median down, and at mask pixels only, so that the table does not either. Where fewer than a quarter of these carry
    depth, a hole stays a hole.

    Args:
        form: ``(P, 2)`` pixels.
        depth: The frame's, see ``frame.depth_images``.
        region: The mask.
        width: The object's width, pixels.
    """
    left, top = region.window[:2]
    reach = min(max(round(width / 4), 1), MAX_REACH)
    points = np.ascontiguousarray(form.points, dtype=np.float64)
    where = depth, region.mask, left, top
    if isinstance(form, FittedLattice):
        (rows, down), (cols, right) = _some(form.rows), _some(len(points) // form.rows)
        some = np.ascontiguousarray(form.lattice[np.ix_(rows, cols)].reshape(-1, 2))
        read = median_depth(*where, some, reach, MIN_SHARE, True)[0].reshape(len(rows), -1)
        known = np.isfinite(read)
        share = down @ known @ right.T
        z = down @ np.where(known, read, 0) @ right.T / np.maximum(share, 1e-9)
        return np.where(share > 0.5, z, np.nan).ravel()
    z, _ = median_depth(*where, points, reach, MIN_SHARE, not is_rope(form))
    if isinstance(form, FittedCurve) and not form.whole:
        z[form.interpolated] = np.nan
        leave_out_overlaid(z, form.arc[: len(z)], form.interpolated, form.size if form.closed else 0.0, width)
    return z


@lru_cache(maxsize=16)
def _some(count: int) -> tuple[npt.NDArray[np.int64], Array]:
    """Return every third row of ``count`` and the last, ``(S,)``, and how all follow from them, ``(count, S)``."""
    nodes = np.unique(np.append(np.arange(0, count, 3), count - 1))
    return nodes, np.stack([np.interp(np.arange(count), nodes, each) for each in np.eye(len(nodes))], axis=1)


def is_rope(form: FittedForm) -> bool:
    """Return whether a form is an open curve: the depth under it does not slope across it."""
    return isinstance(form, FittedCurve) and not form.closed


def lift_form(form: FittedForm, z: Array, intrinsics: Intrinsics) -> Array | None:
    """Return a whole form in space, for measuring distances in metres.

    Holes are bridged and the depth is smoothed over a few points (millimetre steps would make the form longer than it
    is); the points that leave the detector are lifted again.

    Args:
        form: ``(P, 2)`` pixels.
        z: ``(P,)`` metres, as ``form_depth`` gives them.
        intrinsics: The projection.

    Returns:
        ``(P, 3)`` metres, or None where less than half of the form has depth, or the lens has no ray to some of it.
    """
    known = np.isfinite(z)
    if known.mean() < 0.5:
        return None
    points = intrinsics.deproject(form.points, form.smoothed(z, known))
    return points if np.isfinite(points).all() else None


@compiled("(f8[::1], f8[::1], b1[::1], f8, f8)")
def leave_out_overlaid(z: Array, arc: Array, bridged: npt.NDArray[np.bool_], around: float, width: float) -> None:
    """Set depth next to a hidden piece to NaN that is that of what hides the piece, and not the curve's own.

    The camera's two eyes see past an edge differently, and depth is smeared there: it is compared with that of the
    curve a little further away, else with that of all of it.

    Args:
        z: ``(P,)`` metres under the curve, NaN or 0 where it is not known; changed in place.
        arc: ``(P,)`` arc length in the image, pixels.
        bridged: ``(P,)`` what is hidden, or bridged.
        around: Length of a closed curve, pixels; 0 for an open one.
        width: Of the rope, pixels.
    """
    size = len(z)
    own, near, places = np.zeros(size, np.bool_), np.empty(size), np.empty(size)
    for p in range(size):
        own[p] = z[p] > 0 and not bridged[p]
        for q in range(size):
            if own[p] and bridged[q]:
                own[p] = abs(_ahead(arc[p], arc[q], around)) > SMEARED * width
    for p in range(size):
        if bridged[p] or own[p] or not z[p] > 0:
            continue
        count, limit = 0, np.inf
        for q in range(size):
            away = _ahead(arc[p], arc[q], around)
            if own[q] and abs(away) <= COMPARED * width:
                near[count], places[count] = z[q], away
                count += 1
        if count > 0:
            limit = nearest_expected(places[:count], near[:count], 0.0)
        elif own.any():
            limit = np.median(z[own])
        if math.isfinite(limit) and z[p] < limit - STEP:
            z[p] = np.nan


@compiled
def _ahead(start: float, stop: float, around: float) -> float:
    """Return how far one place lies ahead of another along a curve; the shorter way around a closed one."""
    away = stop - start
    return away if around == 0 else away - around * math.floor(away / around + 0.5)


@compiled
def nearest_expected(arc: Array, metres: Array, at: float) -> float:
    """Return the least depth that a rope may have at a place, by its depth a little further away.

    Args:
        arc: ``(K,)`` arc positions, pixels; at least one.
        metres: ``(K,)`` depth there.
        at: The place. The rope may go on as level as it is, or as steeply.
    """
    values = room(len(metres))
    for k in range(len(metres)):
        values[k] = metres[k]
    level, middle, mean = median(values, len(metres)), arc.mean(), metres.mean()
    spread = slope = 0.0
    for k in range(len(arc)):
        spread += (arc[k] - middle) ** 2
        slope += (arc[k] - middle) * (metres[k] - mean)
    return min(level, mean + slope / spread * (at - middle)) if spread > 0 else level
