"""From pixels to metres: robust local depth under each point."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics
from shape_obs.compiled.interface import MILLIMETRE
from shape_obs.geometry.form import Curve, Form
from shape_obs.image.region import Region
from shape_obs.tracking.occluders import overlaid

Array = npt.NDArray[np.float64]

_UNITS: Final = {"H": MILLIMETRE, "f": 1.0, "d": 1.0}  # metres, of uint16, float32 and float64
_MIN_SHARE: Final = 0.25  # of the mask pixels around a point, that must carry depth
_MAX_REACH: Final = 6  # pixels: what is wider is no rope, and its depth is its own at every place


def local_depth(points: Array, depth: npt.NDArray[Any], region: Region, width: float) -> Array:
    """Median depth of the mask around each point.

    Looks at the middle half of the object's width (13 pixels at most), so that a round rope's flanks do not pull the
    median down, and at mask pixels only, so that the table does not either.

    Args:
        points: (N,2) pixels.
        depth: (H,W) the frame's depth.
        region: The mask.
        width: The object's width, pixels.

    Returns:
        (N,) metres; NaN where fewer than a quarter of the mask pixels carry depth: a hole stays a hole.
    """
    reach = min(max(round(width / 4), 1), _MAX_REACH)
    if depth.dtype.char not in _UNITS or not depth.dtype.isnative:
        depth = depth.astype(np.float64)
    unit = _UNITS[depth.dtype.char]
    depth = depth.view()
    depth.flags.writeable = False  # one type for all, or arrays that are read-only would be compiled for anew
    left, top = region.window[:2]
    return region.kernels.median_depth(depth, unit, region.mask, left, top, points, reach, _MIN_SHARE)


def lift(points: Array, z: Array, intrinsics: Intrinsics, radius: float) -> Array:
    """Points on the object: the visible surface, or with ``radius`` the axis behind it.

    Args:
        points: (N,2) pixels.
        z: (N,) metres, NaN where unknown.
        intrinsics: The projection.
        radius: Metres from the surface to the axis along the viewing ray; 0 stays on the surface.

    Returns:
        (N,3) metres, camera frame; NaN where unknown.
    """
    rays = intrinsics.rays(points)
    if radius:
        z = z + radius / np.linalg.norm(rays, axis=1)
    return rays * z[:, None]


def form_depth(form: Form, depth: npt.NDArray[Any], region: Region, width: float) -> Array:
    """(P,) metres under a form, NaN where it is not known or belongs to something that lies over it."""
    z = local_depth(form.points, depth, region, width)
    if isinstance(form, Curve) and not form.whole:
        z[form.bridged | overlaid(form, z, width)] = np.nan
    return z


def lift_form(form: Form, z: Array, intrinsics: Intrinsics) -> Array | None:
    """A whole form in space, for measuring distances in metres.

    Holes are bridged and the depth is smoothed over a few points (millimetre steps would make the form longer than it
    is); the points that leave the detector are lifted afresh.

    Args:
        form: (P,2) pixels.
        z: (P,) metres, as ``form_depth`` gives them.
        intrinsics: The projection.

    Returns:
        (P,3) metres, or None where less than half of the form has depth, or the lens has no ray to some of it.
    """
    known = np.isfinite(z)
    if known.mean() < 0.5:
        return None
    points = intrinsics.deproject(form.points, form.smoothed(z, known))
    return points if np.isfinite(points).all() else None
