"""A cloud that a camera saw: the depth under a mask, as a body in space, with its image."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np
import numpy.typing as npt
from scipy.ndimage import median
from scipy.spatial import KDTree

from shape_obs.camera import Intrinsics
from shape_obs.frame import FARTHEST, depth_images, depth_in_metres
from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.observed import MAD_SIGMA, Observed
from shape_obs.image.region import Region
from shape_obs.point_cloud.cloud import Cloud
from shape_obs.point_cloud.lifting import form_depth, lift_form

if TYPE_CHECKING:  # a protocol's property accepts no other descriptor
    cached_property = property
else:
    from functools import cached_property

Array = npt.NDArray[np.float64]

_MOST: Final = 6000  # pixels
_THICK: Final = 5.0  # pixels: from this width on a mask can spare its border, where depth mixes with what is behind
# Depth is compared with the median of its cell, in pixels; what lies off it by more than so many times the median
# deviation (as a standard deviation) belongs to what is behind or flies in between. Metres: the least that is off.
_CELL: Final = (6, 16)
_OFF: Final = 3 * MAD_SIGMA
_TOLERANCE: Final = 0.004
# Points of a sheet's border, each on the plane through so many samples near it; and what keeps that plane from
# tipping where they lie in a line, square pixels.
_RIM: Final = 300
_NEIGHBOURS: Final = 8
_RIDGE: Final = 1.0
# Pixels off the mask in a line that part two strands; fewer are specks. Pixels of a line that are looked at.
_APART: Final = 2
_SIGHT: Final = 64
_UNKNOWN: Final = "less than half of the curve has depth under it"


@dataclass(frozen=True, eq=False)
class SeenCloud(Cloud):
    """The points under a mask, camera frame.

    Args:
        region: The mask.
        depth: ``(H, W)`` the frame's depth.
        intrinsics: The projection.
    """

    region: Region
    depth: npt.NDArray[Any]
    intrinsics: Intrinsics

    def pixels_of(self, points: Array) -> Array:
        """Return ``(N, 3)`` metres -> ``(N, 2)`` pixels."""
        return self.intrinsics.project(points)

    def seen(self, points: Array, target: Array | None) -> Array:
        """Return ``(N, 2)`` pixels."""
        return self.pixels_of(points)

    @property
    def refusal(self) -> str:
        """The mask's, if nothing in it was measured; else the cloud's."""
        return (self.region.refusal if not self.region.pieces else "") or super().refusal

    @property
    def parts(self) -> tuple[Observed, ...]:
        """The observations that an initial axis is taken from: the cloud and its mask."""
        return self, self.region

    def carries(self, points: Array) -> npt.NDArray[np.bool_]:
        """Return whether the mask has a pixel where ``(N, 3)`` points are seen: depth may have holes there."""
        pixels = self.pixels_of(points)
        ahead = np.isfinite(pixels[:, 0])
        return ahead & self.region.carries(np.where(ahead[:, None], pixels, -1e6))

    @cached_property
    def _sheet(self) -> tuple[Array, Array]:
        """The border is the mask's, which is sharper than the cloud's and has no holes where depth is missing."""
        rim = self.region.outline.curve
        if len(self.samples) < _NEIGHBOURS or not rim.size:  # that of a single pixel has no length
            return super()._sheet
        pixels = rim.at(np.arange(_RIM) * (rim.size / _RIM))
        samples = self.pixels_of(self.samples.points)
        tree: Any = KDTree(samples)
        _, near = tree.query(pixels, k=np.arange(_NEIGHBOURS) + 1)
        # The inverse depth of a plane is linear in the pixel.
        away = np.concatenate([np.ones((*near.shape, 1)), samples[near] - pixels[:, None]], axis=2)
        inverse = 1 / self.samples.points[near, 2]
        normal = np.einsum("pki,pkj->pij", away, away) + _RIDGE * np.diag([0.0, 1.0, 1.0])
        solved = np.linalg.solve(normal, np.einsum("pki,pk->pi", away, inverse)[..., None])[:, 0, 0]
        # The border goes as far beyond its samples as they are apart, and stays in front of the camera.
        low, high = inverse.min(axis=1), inverse.max(axis=1)
        depth = 1 / np.clip(solved, np.maximum(2 * low - high, low / 2), 2 * high - low)
        outline = self.intrinsics.deproject(pixels, depth)
        if not (np.abs(outline) < FARTHEST).all():  # the lens has no ray at some of the border
            return super()._sheet
        return outline, self.chart.to_flat(outline, near[:, 0])

    def connected_ahead(self, place: Array, points: Array, along: Array, width: float) -> npt.NDArray[np.bool_]:
        """Return which points near a place belong to its strand: those to which the mask goes on straight."""
        ends, start = self.pixels_of(points), self.pixels_of(place)
        if not np.isfinite(start).all():  # behind the camera
            return np.zeros(len(points), bool)
        longest = float(np.fmax.reduce(np.abs(ends - start), axis=None, initial=1.0))
        steps = int(np.ceil(min(longest, _SIGHT)))  # one a pixel
        line = start + (ends - start)[:, None] * np.linspace(0, 1, steps + 1)[:, None]
        off = ~self.region.contains(line.reshape(-1, 2)).reshape(line.shape[:2])
        return off.sum(axis=1) < _APART

    def lifted(self, curve: FittedCurve) -> FittedCurve:
        """Return a curve over the image, in pixels, in space."""
        under = form_depth(curve, depth_images(self.depth), self.region, self.region.width)
        points = lift_form(curve, under, self.intrinsics)
        if points is None:
            return replace(curve, ambiguity=curve.ambiguity or _UNKNOWN)
        return curve.with_points(points)


def deproject(region: Region, depth: npt.NDArray[Any], intrinsics: Intrinsics) -> SeenCloud:
    """Return the points under a mask whose depth can be trusted.

    Args:
        region: The mask.
        depth: ``(H, W)`` uint16 millimetres or floating metres; 0, negative or non-finite = invalid.
        intrinsics: The projection.
    """
    pixels = _inner(region)
    if len(pixels) > _MOST:  # drawn at random: evenly spaced pixels would fall into stripes
        pixels = pixels[np.random.default_rng(0).choice(len(pixels), _MOST, replace=False)]
    uv = pixels + np.array([region.window.left, region.window.top])
    z = depth_in_metres(depth[uv[:, 1], uv[:, 0]])
    known = np.isfinite(z)
    pixels, uv, z = pixels[known], uv[known], z[known]
    size = int(np.clip(region.width, *_CELL)) if len(z) else 1
    cell = pixels[:, 1] // size * (region.mask.shape[1] // size + 1) + pixels[:, 0] // size
    off = np.abs(z - _median(z, cell))
    kept = off <= np.maximum(_OFF * _median(off, cell), _TOLERANCE)
    points = intrinsics.deproject(uv[kept].astype(np.float64), z[kept])
    plausible = (np.abs(points) < FARTHEST).all(axis=1)  # an absurd lens sees farther, or has no ray there
    return SeenCloud(points[plausible], region, depth, intrinsics)


def _inner(region: Region) -> npt.NDArray[np.int32]:
    """Return ``(M, 2)`` pixels of the mask, window coordinates, without its border where it is thick enough."""
    if not region.pieces or region.width < _THICK:
        return region.pixels
    inner = cv2.erode(region.mask, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return replace(region, mask=inner).pixels


def _median(values: Array, cell: npt.NDArray[Any]) -> Array:
    """Return ``(M,)`` the median of each value's cell."""
    return np.asarray(median(values, cell, np.arange(cell.max() + 1)))[cell] if len(cell) else values
