"""From a fitted form to the points of a shape: spread evenly, flagged as visible or not, and put in space."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics, stereo_noise, viewing_rays
from shape_obs.configurations.base import Configuration, Points
from shape_obs.configurations.points_in_image import Seen, seen_points
from shape_obs.geometry.curve import FittedCurve, local_stretch
from shape_obs.geometry.lattice import FittedLattice
from shape_obs.geometry.topology import Grid
from shape_obs.point_cloud.lifting import form_depth, lift_form
from shape_obs.point_cloud.local_depth import median_depth
from shape_obs.shape import Shape
from shape_obs.tracking.belief import error_on_sheet, errors_in_cloud, known_layout, point_errors
from shape_obs.tracking.missing import OnInvalid, fill_invalid
from shape_obs.tracking.model import LatticeModel
from shape_obs.tracking.predict import Fit
from shape_obs.tracking.scene import Scene
from shape_obs.tracking.validation import validate_gaps

if TYPE_CHECKING:
    from shape_obs.image.region import Region
    from shape_obs.point_cloud.cloud import Cloud

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_HALF_ROUND: Final = np.pi / 4  # radii by which a fit to the visible half of a round rope lies in front of its axis
_SMOOTH: Final = 3.0  # points of the fine curve, over which its direction is taken


def shape_of(
    spec: Configuration, found: Fit, scene: Scene, last: Shape | None, policy: OnInvalid, number: int
) -> Shape:
    """Return the shape of a fit, with a reason if it cannot be right.

    Args:
        spec: What was looked for.
        found: The form, in pixels on a mask, in metres in a cloud, its quality, and what it was fitted to.
        scene: Depth and camera, for a mask.
        last: The shape when it was last found.
        policy: What becomes of points without depth.
        number: Of its track.
    """
    if found.observed.dimension == 2:
        points2d, points3d, visible, valid, sigma = _points_in_image(spec, found, scene)
        points3d = points3d if len(points3d) else None
    else:
        points2d, points3d, visible, valid, sigma = _points_in_cloud(spec, found, scene.intrinsics)
    known = int(np.count_nonzero(valid))
    reason = _doubt(spec, found, points2d, points3d, valid if known else None, scene.intrinsics)
    if points3d is not None and known < len(valid):
        points3d = fill_invalid(points3d, valid, None if last is None else last.points3d, policy)
    quality = found.quality * (known / len(valid))
    return Shape(
        spec.name, points2d, points3d, visible, valid, spec.layout, quality=quality, sigma=sigma, reason=reason,
        length=_length_of(found), track_id=number, new=last is None or last.track_id != number,
    )  # fmt: skip


def _doubt(
    spec: Configuration,
    found: Fit,
    points2d: npt.NDArray[np.float32] | None,
    points3d: npt.NDArray[np.float32] | None,
    valid: Mask | None,
    camera: Intrinsics | None,
) -> str:
    """Return why points cannot be right though their form was found; empty if they can."""
    if points2d is not None and np.count_nonzero(np.isfinite(points2d)) < points2d.size:
        return "it runs out of the camera's sight"
    if points3d is None:
        return ""
    if valid is None:
        return "no point has depth under it"
    if isinstance(found.form, FittedLattice) and found.form.ambiguity:  # a rope may begin again
        return found.form.ambiguity
    equal = spec.spacing == "m" and found.observed.dimension == 2 and found.centres is None
    if camera is None or not equal or not isinstance(spec.layout, Grid) or not isinstance(spec.model, LatticeModel):
        return ""
    error = error_on_sheet(float(points3d[valid, 2].mean()), camera)
    return validate_gaps(points3d.astype(np.float64), valid, spec.layout, error, spec.model)


def _length_of(found: Fit) -> float | None:
    """Return the length of a curve in metres, as its track remembers it; None if it is not known."""
    rope = None if found.track is None else found.track.rope
    if rope is not None and rope["metres"][0] > 0:
        return float(rope["metres"][0])
    return found.size if found.observed.dimension == 3 and isinstance(found.form, FittedCurve) else None


def _points_in_image(spec: Configuration, found: Fit, scene: Scene) -> Seen:
    """Return points in pixels with the depth under them; where there is none, with their neighbours' depth."""
    region: Region = found.observed
    form, depth, camera, width = found.form, scene.depth, scene.intrinsics, found.object_width
    metric, under = form, None
    if depth is not None and camera is not None:
        curve = form if isinstance(form, FittedCurve) else None
        in_pieces = curve is not None and not curve.whole and _is_bridged(curve)
        uneven = spec.spacing == "m" and (curve is None or (not len(curve.metres) and curve.space is None))
        if uneven or in_pieces:
            under = form_depth(form, scene.images, region, width)
            lifted = lift_form(form, under, camera) if uneven else None
            metric = form if lifted is None else form.with_points(lifted)
        under = under if in_pieces else None
    points, interpolated, at, log_depth, steep, off = (
        spec.resample(form, metric) if found.centres is None else _without_gaps(found.centres)
    )
    if isinstance(form, FittedCurve) and at is None and (len(form.log_depth) or under is not None):
        at = _nearest(points, form.points)
        if len(form.log_depth):  # the points are a clusterer's
            stretched = local_stretch(form.arc, np.column_stack([form.points, form.log_depth]), width / 2)
            log_depth, steep = form.log_depth[at], stretched[at]
    # Next to what hides a piece, depth that is not the form's is not the points' either.
    foreign = np.zeros(0, bool) if under is None else np.isnan(under)[at]
    return seen_points(
        points, interpolated, log_depth, steep, foreign, off, form.size, scene.images, region.mask,
        region.window[:2], width, scene.lens, spec.radius, *known_layout(spec.layout), scene.size[1],
        math.hypot(*scene.size),
    )  # fmt: skip


def _is_bridged(curve: FittedCurve) -> bool:
    """Return whether a piece of a curve is interpolated over which points are spread."""
    first, past = curve.shown or (0, len(curve.points))
    return bool(curve.interpolated[first:past].any())


def _points_in_cloud(
    spec: Configuration, found: Fit, camera: Intrinsics | None
) -> tuple[npt.NDArray[np.float32] | None, npt.NDArray[np.float32], Mask, Mask, npt.NDArray[np.float32]]:
    """Return the fitted points themselves, of a curve moved to the axis; pixels are their projection."""
    cloud: Cloud = found.observed
    form, centres = found.form, found.centres
    if spec.radius and isinstance(form, FittedCurve):
        shift = _HALF_ROUND * spec.radius * _inwards(form)
        if centres is not None:
            centres = centres + shift[_nearest(centres, form.points)]
        form = form.with_points(form.points + shift)
    points, interpolated, *_, off = spec.resample(form, form) if centres is None else _without_gaps(centres)
    visible = cloud.carries(points) & ~interpolated
    valid, pixels, points3d = visible & cloud.near(points), cloud.pixels_of(points), points.astype(np.float32)
    sigma = errors_in_cloud(points3d, visible, valid, spec.layout, form.size, cloud.resolution, camera, off)
    return None if pixels is None else pixels.astype(np.float32), points3d, visible, valid, sigma


def _without_gaps(centres: Array) -> Points:
    """Return the points that a clusterer found, none of them in a gap."""
    return Points(centres, np.zeros(len(centres), bool))


def _nearest(points: Array, others: Array) -> npt.NDArray[np.intp]:
    """Return which of the others ``(P, D)`` is nearest to each of ``(N, D)`` points."""
    return np.argmin(np.sum((points[:, None] - others) ** 2, axis=2), axis=1)


def _inwards(curve: FittedCurve) -> Array:
    """Return ``(P, 3)`` unit vectors away from the origin, at right angles to the curve: towards a rope's axis."""
    from scipy.ndimage import gaussian_filter1d  # takes 0.2 s to import

    points, mode = curve.points, "wrap" if curve.closed else "nearest"
    tangent = np.stack([gaussian_filter1d(points[:, d], _SMOOTH, order=1, mode=mode) for d in range(3)], axis=1)
    square = np.maximum(np.sum(tangent**2, axis=1, keepdims=True), 1e-18)
    across = points - tangent * (np.sum(points * tangent, axis=1, keepdims=True) / square)
    return across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)


SHAPE_FUNCTIONS: Final = seen_points, point_errors, median_depth, viewing_rays, stereo_noise
