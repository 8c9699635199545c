"""From a form to the points of a shape: spread evenly, told whether they were seen, and put in space."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.distance import cdist

from shape_obs.configurations import Configuration
from shape_obs.configurations.base import Points
from shape_obs.configurations.fitting import Fit
from shape_obs.frame import Frame
from shape_obs.geometry.form import Curve, Form
from shape_obs.image.region import Region
from shape_obs.point_cloud.body import Body
from shape_obs.point_cloud.cloud import Cloud
from shape_obs.point_cloud.deprojection import SeenCloud
from shape_obs.point_cloud.lifting import form_depth, lift, lift_form, local_depth
from shape_obs.shape import Shape
from shape_obs.tracking.missing import OnInvalid, fill_invalid

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# What is fitted to the visible half of a round rope lies this share of a radius in front of its axis.
_HALF_ROUND: Final = np.pi / 4
_SMOOTH: Final = 3.0  # points of the fine curve, over which its direction is taken


def shape_of(
    spec: Configuration, found: Fit, form: Form, body: Body, frame: Frame, last: Shape | None, policy: OnInvalid
) -> Shape:
    """The shape of a fit.

    Args:
        spec: What was looked for.
        found: What the gate said.
        form: Where it lies, pixels on a mask, metres in a cloud.
        body: What it was fitted to.
        frame: Depth and camera, for a mask.
        last: The shape when it was last found.
        policy: What becomes of points without depth.
    """
    if isinstance(body, Cloud):
        points2d, expected, visible, valid = _in_cloud(spec, form, body, found.centres)
    else:
        points2d, expected, visible, valid = _in_image(spec, form, body, frame, found.centres)
    points3d = None
    if expected is not None:
        points3d = fill_invalid(expected, valid, None if last is None else last.points3d, policy)
    quality = found.quality * (np.count_nonzero(valid) / len(valid))
    return Shape(spec.name, points2d, points3d, visible, valid, spec.layout, quality=quality)


# Pixels, points in space (those that were not seen where the form puts them), visible, valid.
_Parts = tuple[npt.NDArray[np.float32] | None, npt.NDArray[np.float32] | None, Mask, Mask]


def _in_image(spec: Configuration, form: Form, region: Region, frame: Frame, centres: Array | None) -> _Parts:
    """Points in pixels with the depth under them; where there is none, with their neighbours'."""
    metric, camera, under = form, frame.camera, None
    in_pieces = isinstance(form, Curve) and not form.whole
    if frame.depth is not None and camera is not None and (spec.spacing == "m" or in_pieces):
        under = form_depth(form, frame.depth, region, region.width)
    if spec.spacing == "m" and under is not None and camera is not None:
        lifted = lift_form(form, under, camera.intrinsics)
        metric = form if lifted is None else form.measured(lifted)
    points, bridged = spec.place(form, metric) if centres is None else _given(centres)
    visible = region.carries(points) & ~bridged
    if frame.depth is None or camera is None:
        return points.astype(np.float32), None, visible, visible.copy()
    z = local_depth(points, frame.depth, region, region.width)
    if in_pieces and under is not None:
        # Beside what hides a piece, depth that is not the form's is not the points' either.
        z[np.isnan(under)[np.argmin(cdist(points, form.points), axis=1)]] = np.nan
    valid = visible & np.isfinite(z)
    if 0 < np.count_nonzero(valid) < len(valid):
        z = spec.layout.interpolate(z[:, None], valid)[:, 0]
    points3d = lift(points, z, camera.intrinsics, spec.radius).astype(np.float32)
    valid &= np.isfinite(points3d).all(axis=1)  # the lens may have no ray there
    return points.astype(np.float32), points3d, visible, valid


def _in_cloud(spec: Configuration, form: Form, cloud: Cloud, centres: Array | None) -> _Parts:
    """The fitted points themselves, of a curve moved to the axis; pixels are their projection."""
    if spec.radius and isinstance(form, Curve):
        shift = _HALF_ROUND * spec.radius * _inwards(form)
        if centres is not None:
            centres = centres + shift[np.argmin(cdist(centres, form.points), axis=1)]
        form = form.measured(form.points + shift)
    points, bridged = spec.place(form, form) if centres is None else _given(centres)
    visible = cloud.carries(points) & ~bridged
    valid = visible & cloud.near(points)
    if not isinstance(cloud, SeenCloud):
        visible = valid.copy()
    points2d = cloud.pixels(points).astype(np.float32) if isinstance(cloud, SeenCloud) else None
    return points2d, points.astype(np.float32), visible, valid


def _given(centres: Array) -> Points:
    """A clusterer's centres: it knows of no gaps."""
    return Points(centres, np.zeros(len(centres), bool))


def _inwards(curve: Curve) -> Array:
    """(P,3) unit vectors away from the origin, at right angles to the curve: from a rope's visible side to its axis."""
    points, mode = curve.points, "wrap" if curve.closed else "nearest"
    tangent = np.stack([gaussian_filter1d(points[:, d], _SMOOTH, order=1, mode=mode) for d in range(3)], axis=1)
    square = np.maximum(np.sum(tangent**2, axis=1, keepdims=True), 1e-18)
    across = points - tangent * (np.sum(points * tangent, axis=1, keepdims=True) / square)
    return across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
