"""From a fitted form to the points of a shape: spread evenly, flagged as visible or not, and put in space."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.distance import cdist

from shape_obs.configurations.base import Configuration, Points
from shape_obs.frame import Frame
from shape_obs.geometry.curve import FittedCurve
from shape_obs.image.region import Region
from shape_obs.point_cloud.cloud import Cloud
from shape_obs.point_cloud.lifting import form_depth, lift, lift_form, local_depth
from shape_obs.shape import Shape
from shape_obs.tracking.missing import OnInvalid, fill_invalid
from shape_obs.tracking.prediction import Fit

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# What is fitted to the visible half of a round rope lies this share of a radius in front of its axis.
_HALF_ROUND: Final = np.pi / 4
_SMOOTH: Final = 3.0  # points of the fine curve, over which its direction is taken


def shape_of(spec: Configuration, found: Fit, frame: Frame, last: Shape | None, policy: OnInvalid) -> Shape:
    """Return the shape of a fit.

    Args:
        spec: What was looked for.
        found: The form, in pixels on a mask, in metres in a cloud, its quality, and what it was fitted to.
        frame: Depth and camera, for a mask.
        last: The shape when it was last found.
        policy: What becomes of points without depth.
    """
    if isinstance(found.observed, Region):
        points2d, points3d, visible, valid = _points_in_image(spec, found, found.observed, frame)
    else:
        points2d, points3d, visible, valid = _points_in_cloud(spec, found, found.observed)
    if points3d is not None:
        points3d = fill_invalid(points3d, valid, None if last is None else last.points3d, policy)
    quality = found.quality * (np.count_nonzero(valid) / len(valid))
    return Shape(spec.name, points2d, points3d, visible, valid, spec.layout, quality=quality)


# Pixels, points in space (those that were not seen where the form puts them), visible, valid.
_Parts = tuple[npt.NDArray[np.float32] | None, npt.NDArray[np.float32] | None, Mask, Mask]


def _points_in_image(spec: Configuration, found: Fit, region: Region, frame: Frame) -> _Parts:
    """Return points in pixels with the depth under them; where there is none, with their neighbours' depth."""
    form = metric = found.form
    depth, camera, under = frame.depth, frame.camera, None
    in_pieces = isinstance(form, FittedCurve) and not form.whole
    if depth is not None and camera is not None and (spec.spacing == "m" or in_pieces):
        under = form_depth(form, depth, region)
        lifted = lift_form(form, under, camera.intrinsics) if spec.spacing == "m" else None
        metric = form if lifted is None else form.with_points(lifted)
    points, interpolated = _placed(spec, found.centres, form, metric)
    visible = region.carries(points) & ~interpolated
    if depth is None or camera is None:
        return points.astype(np.float32), None, visible, visible.copy()
    z = local_depth(points, depth, region)
    if in_pieces and under is not None:
        # Next to what hides a piece, depth that is not the form's is not the points' either.
        z[np.isnan(under)[np.argmin(cdist(points, form.points), axis=1)]] = np.nan
    valid = visible & np.isfinite(z)
    if 0 < np.count_nonzero(valid) < len(valid):
        z = spec.layout.interpolate(z[:, None], valid)[:, 0]
    points3d = lift(points, z, camera.intrinsics, spec.radius).astype(np.float32)
    valid &= np.isfinite(points3d).all(axis=1)  # the lens may have no ray there
    return points.astype(np.float32), points3d, visible, valid


def _points_in_cloud(spec: Configuration, found: Fit, cloud: Cloud) -> _Parts:
    """Return the fitted points themselves, of a curve moved to the axis; pixels are their projection."""
    form, centres = found.form, found.centres
    if spec.radius and isinstance(form, FittedCurve):
        shift = _HALF_ROUND * spec.radius * _inwards(form)
        if centres is not None:
            centres = centres + shift[np.argmin(cdist(centres, form.points), axis=1)]
        form = form.with_points(form.points + shift)
    points, interpolated = _placed(spec, centres, form, form)
    visible = cloud.carries(points) & ~interpolated
    pixels = cloud.pixels_of(points)
    return (
        None if pixels is None else pixels.astype(np.float32),
        points.astype(np.float32),
        visible,
        visible & cloud.near(points),
    )


def _placed(spec: Configuration, centres: Array | None, form: object, metric: object) -> Points:
    """Return the points that a clusterer found, which does not know of gaps, or those spread evenly on the form."""
    if centres is not None:
        return Points(centres, np.zeros(len(centres), bool))
    return spec.resample(form, metric)


def _inwards(curve: FittedCurve) -> Array:
    """Return ``(P, 3)`` unit vectors away from the origin, at right angles to the curve: towards a rope's axis."""
    points, mode = curve.points, "wrap" if curve.closed else "nearest"
    tangent = np.stack([gaussian_filter1d(points[:, d], _SMOOTH, order=1, mode=mode) for d in range(3)], axis=1)
    square = np.maximum(np.sum(tangent**2, axis=1, keepdims=True), 1e-18)
    across = points - tangent * (np.sum(points * tangent, axis=1, keepdims=True) / square)
    return across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
