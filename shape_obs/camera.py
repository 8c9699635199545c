"""Cameras: intrinsics with lens distortion, the noise of depth, and the camera's place in the robot's base frame.

Conventions, everywhere in shape_obs: pixels are ``(u right, v down)`` with pixel centres at integers; the camera
frame is the optical frame ``(x right, y down, z forward)`` in metres; depth is ``z``, not the length of the ray.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Literal, get_args

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.foreign_cameras import read_fields
from shape_obs.spec import Spec, SpecError, did_you_mean
from shape_obs.utils.lengths import warn_unless_metres

#: A camera in any form that ``as_camera_model`` reads.
CameraLike = Any
Distortion = Literal["pinhole", "brown_conrady", "inverse_brown_conrady"]
_INVERSE: Final = 2  # the number of librealsense's model among ``Distortion``
_MAX_ITERATIONS: Final = 60
_TOLERANCE: Final = 1e-10
_CONVERGED: Final = 1e-3  # of the distance z; where the last step is larger, the lens has no such ray
# Accepted values. What lies outside is a mistake, and its arithmetic would overflow.
_FOCAL: Final = (1e-3, 1e9)  # pixels
_MAX_CENTER: Final = 1e9  # pixels
_MAX_COEFF: Final = 1e6
_MAX_DISTANCE: Final = 1e9  # metres, from the base
_ORTHONORMAL: Final = 1e-4  # largest entry of R R^T - 1
_ROUNDED: Final = 1e-2  # the same of a rotation typed with two or three digits
_MAX_PIXEL: Final = 1e12  # farther off, a projected point counts as out of sight
_MAX_DISPARITY: Final = 1e3  # pixels
_MAX_BASELINE: Final = 1e3  # metres
_NATIVE: Final = 640  # columns; an image with fewer is one of this width that was made smaller

Points = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Intrinsics(Spec):
    """A camera's projection: image size, focal lengths, principal point and lens distortion.

    Args:
        width: Image width in pixels.
        height: Image height in pixels.
        fx: Focal length along u, in pixels.
        fy: Focal length along v, in pixels.
        cx: Principal point's u, in pixels (pixel centres at integers).
        cy: Principal point's v, in pixels.
        model: ``"pinhole"``, ``"brown_conrady"`` (OpenCV's five-parameter model) or ``"inverse_brown_conrady"``
            (librealsense's, in which the tangential part acts on the radially distorted point).
        coeffs: ``(k1, k2, p1, p2, k3)``; all zero for a pinhole.

    Raises:
        SpecError: A value has a wrong type, or the model is unknown.
        ValueError: A value is out of range, or a pinhole has coefficients.

    References:
        D. C. Brown, "Decentering Distortion of Lenses", Photogrammetric Engineering 32(3), 1966; librealsense,
        ``rsutil.h``: ``rs2_project_point_to_pixel`` and ``rs2_deproject_pixel_to_point``.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    model: Distortion = "pinhole"
    coeffs: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.width < 1 or self.height < 1:
            raise ValueError(f"Intrinsics: width and height must be positive, got {self.width} x {self.height}.")
        low, high = _FOCAL
        if not (low <= self.fx <= high and low <= self.fy <= high):
            raise ValueError(f"Intrinsics: fx and fy must lie in {low}...{high:g} pixels, got {self.fx} and {self.fy}.")
        if not (abs(self.cx) <= _MAX_CENTER and abs(self.cy) <= _MAX_CENTER):
            raise ValueError(
                f"Intrinsics: cx and cy must lie in +-{_MAX_CENTER:g} pixels, got {self.cx} and {self.cy}."
            )
        if len(self.coeffs) != 5 or not all(abs(value) <= _MAX_COEFF for value in self.coeffs):
            raise ValueError(
                f"Intrinsics: coeffs must be five numbers (k1, k2, p1, p2, k3) in +-{_MAX_COEFF:g}, got {self.coeffs}."
            )
        if self.model == "pinhole" and any(self.coeffs):
            raise ValueError(
                f"Intrinsics: a pinhole has no distortion, but coeffs are {self.coeffs}: add model='brown_conrady' for "
                "OpenCV's and ROS's coefficients or model='inverse_brown_conrady' for those of a RealSense colour "
                "stream, or leave them out if the image is rectified."
            )

    @property
    def matrix(self) -> npt.NDArray[np.float64]:
        """The ``(3, 3)`` camera matrix K."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], dtype=np.float64)

    @property
    def distorted(self) -> bool:
        """Whether the model bends straight lines."""
        return any(self.coeffs)

    def project(self, points: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Project points to pixels.

        Args:
            points: ``(..., 3)`` metres, camera frame.

        Returns:
            ``(..., 2)`` pixels; NaN for points that are not in front of the camera, or too far aside for any image.
        """
        xyz = _as_points(points, 3, "points")
        z = np.where(xyz[..., 2] > 0, xyz[..., 2], np.nan)
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows is too far aside
            xy = self._distort(xyz[..., :2] / z[..., None])
            pixels = xy * (self.fx, self.fy) + (self.cx, self.cy)
        seen = np.abs(pixels) < _MAX_PIXEL
        return pixels if seen.all() else np.where(seen.all(axis=-1, keepdims=True), pixels, np.nan)

    def deproject(self, pixels: npt.ArrayLike, depth: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Lift pixels to points.

        Args:
            pixels: ``(..., 2)`` pixels.
            depth: (...) metres along the optical axis.

        Returns:
            ``(..., 3)`` metres, camera frame; NaN where the depth is NaN or the lens has no such ray.
        """
        rays = self.rays(pixels)
        return rays * np.asarray(depth, dtype=np.float64)[..., None]

    @property
    def size(self) -> tuple[int, int]:
        """(H, W) of the image, pixels."""
        return self.height, self.width

    def rays(self, pixels: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Return viewing rays through pixels, scaled to z = 1: ``(..., 2)`` pixels -> ``(..., 3)``.

        NaN where the distortion cannot be undone: no point in front of the lens is seen at such a pixel.
        """
        uv = _as_points(pixels, 2, "pixels")
        return viewing_rays(np.ascontiguousarray(uv.reshape(-1, 2)), self.lens).reshape(*uv.shape[:-1], 3)

    @cached_property
    def lens(self) -> npt.NDArray[np.float64]:
        """``(10,)`` the projection as compiled code reads it: fx, fy, cx, cy, the model's number, and ``coeffs``."""
        model = get_args(Distortion).index(self.model) if self.distorted else 0
        return np.array([self.fx, self.fy, self.cx, self.cy, model, *self.coeffs], dtype=np.float64)

    def _distort(self, xy: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        if not self.distorted:
            return xy
        radial, tangential = self._terms(xy, xy)
        if self.model == "inverse_brown_conrady":
            tangential = self._terms(xy * radial, xy)[1]
        return xy * radial + tangential

    def _terms(
        self, xy: npt.NDArray[np.float64], radius_of: npt.NDArray[np.float64]
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        k1, k2, p1, p2, k3 = self.coeffs
        x, y = xy[..., 0], xy[..., 1]
        r2 = np.sum(radius_of * radius_of, axis=-1)
        radial = 1 + ((k3 * r2 + k2) * r2 + k1) * r2
        tangential = np.stack([2 * p1 * x * y + p2 * (r2 + 2 * x * x), 2 * p2 * x * y + p1 * (r2 + 2 * y * y)], axis=-1)
        return radial[..., None], tangential


@dataclass(frozen=True)
class CameraModel:
    """A camera and where it stands.

    Args:
        intrinsics: The projection, in any form that ``as_camera_model`` reads.
        transform_camera_to_base: ``(4, 4)`` homogeneous transform, metres, ``p_base = T p_camera``; None if unknown.
    """

    intrinsics: Intrinsics
    transform_camera_to_base: npt.NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "intrinsics", as_intrinsics(self.intrinsics))
        if self.transform_camera_to_base is None:
            return
        transform = rigid_transform(self.transform_camera_to_base, "CameraModel: transform_camera_to_base")
        warn_unless_metres("CameraModel: translation of transform_camera_to_base", transform[:3, 3], stacklevel=4)
        object.__setattr__(self, "transform_camera_to_base", transform)

    def to_base(self, points: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Transform points from the camera frame to the base frame: ``(..., 3)`` in metres."""
        transform = self._transform()
        return _as_points(points, 3, "points") @ transform[:3, :3].T + transform[:3, 3]

    def from_base(self, points: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Transform points from the base frame to the camera frame: ``(..., 3)`` in metres."""
        transform = self._transform()
        return (_as_points(points, 3, "points") - transform[:3, 3]) @ transform[:3, :3]

    def project_from_base(self, points: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Project points of the base frame to pixels: ``(..., 3)`` in metres -> ``(..., 2)``."""
        return self.intrinsics.project(self.from_base(points))

    def _transform(self) -> npt.NDArray[np.float64]:
        if self.transform_camera_to_base is None:
            raise ValueError(
                "CameraModel: this needs the camera's place in the base frame; "
                "give CameraModel(intrinsics, transform_camera_to_base=T) with p_base = T p_camera."
            )
        return self.transform_camera_to_base


@dataclass(frozen=True)
class DepthNoise(Spec):
    """The noise of a stereo camera's depth, which grows with the square of the depth.

    The camera measures the disparity d = f b / z of two images, f being the focal length in pixels and b the baseline.
    An error of the disparity is thus an error of the depth of ``sigma(z) = disparity * z^2 / (f b)``. The defaults are
    those of an Intel RealSense D455 on a well-textured plane.

    Args:
        disparity: Standard deviation of the disparity, in pixels of the depth stream.
        baseline: Distance of the two imagers in metres.

    Raises:
        ValueError: ``disparity`` is below 0, ``baseline`` is not above 0, or one of them is absurdly large.

    References:
        A. Grunnet-Jepsen, J. N. Sweetser, J. Woodfill, "Best-Known-Methods for Tuning Intel RealSense D400 Depth
        Cameras for Best Performance", Intel.

    Example:
        >>> round(1000 * float(DepthNoise().sigma(1.0, focal=386.0)), 2)  # millimetres at one metre
        2.18
    """

    disparity: float = 0.08
    baseline: float = 0.095

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.disparity <= _MAX_DISPARITY:
            raise ValueError(f"DepthNoise: disparity must lie in 0...{_MAX_DISPARITY:g} pixels, got {self.disparity}.")
        if not 0 < self.baseline <= _MAX_BASELINE:
            raise ValueError(f"DepthNoise: baseline must lie in 0...{_MAX_BASELINE:g} metres, got {self.baseline}.")
        warn_unless_metres("DepthNoise: baseline", self.baseline, most=2.0, stacklevel=4)

    def sigma(self, z: npt.ArrayLike, focal: float) -> npt.NDArray[np.float64]:
        """Return the standard deviation of depth in metres.

        Args:
            z: (...) depth in metres.
            focal: Focal length of the depth stream in pixels, above 0.
        """
        if not focal > 0:
            raise ValueError(f"focal: expected pixels above 0, got {focal!r}.")
        metres = np.asarray(z, dtype=np.float64)
        return metres * metres * self.disparity / (focal * self.baseline)


_DISPARITY: Final = DepthNoise.disparity
_BASELINE: Final = DepthNoise.baseline


@compiled("(f8, i8)")
def stereo_noise(focal: float, columns: int) -> float:
    """Return the standard deviation of a pixel's depth at one metre, in metres, of a D455; it grows with the square.

    Args:
        focal: Focal length of the image, pixels.
        columns: Of the image.
    """
    return _DISPARITY / (focal * max(_NATIVE / columns, 1.0) * _BASELINE)


@compiled("(f8[:,::1], f8[::1])")
def viewing_rays(pixels: npt.NDArray[np.float64], lens: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return viewing rays through ``(N, 2)`` pixels, scaled to z = 1: ``(N, 3)``, NaN where the lens has none.

    The distortion is undone by the fixed point that OpenCV and librealsense iterate, to convergence.

    Args:
        pixels: ``(N, 2)``.
        lens: ``(10,)`` see ``Intrinsics.lens``.
    """
    rays = np.ones((len(pixels), 3))
    for n in range(len(pixels)):
        u, v = (pixels[n, 0] - lens[2]) / lens[0], (pixels[n, 1] - lens[3]) / lens[1]
        x, y, change = u, v, 0.0
        for _ in range(_MAX_ITERATIONS if lens[4] > 0 else 0):
            radial, tangential_x, tangential_y = _distortion(x, y, lens)
            if radial == 0:
                change = np.inf
                break
            next_x, next_y = (u - tangential_x) / radial, (v - tangential_y) / radial
            change = max(abs(next_x - x), abs(next_y - y))
            x, y = next_x, next_y
            if not change >= _TOLERANCE:
                break
        found = change < _CONVERGED
        rays[n, 0], rays[n, 1], rays[n, 2] = (x, y, 1.0) if found else (np.nan, np.nan, np.nan)
    return rays


@compiled
def _distortion(x: float, y: float, lens: npt.NDArray[np.float64]) -> tuple[float, float, float]:
    """Return by which factor a lens scales a place at z = 1, and what it adds to both of its coordinates."""
    r2 = x * x + y * y
    radial = 1 + ((lens[9] * r2 + lens[6]) * r2 + lens[5]) * r2
    scale = radial if lens[4] == _INVERSE else 1.0
    a, b = scale * x, scale * y  # librealsense's tangential part acts on the radially distorted point
    across = 2 * lens[7] * a * b + lens[8] * (r2 + 2 * a * a)
    return radial, across, 2 * lens[8] * a * b + lens[7] * (r2 + 2 * b * b)


@compiled
def projected(points: npt.NDArray[np.float64], lens: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return points ``(P, 3)``, metres, as pixels ``(P, 2)``; ``(0, 2)`` if the camera does not see some of them."""
    out = np.empty((len(points), 2))
    for p in range(len(points)):
        if not points[p, 2] > 0:
            return out[:0]
        x, y = points[p, 0] / points[p, 2], points[p, 1] / points[p, 2]
        radial, more_x, more_y = _distortion(x, y, lens) if lens[4] > 0 else (1.0, 0.0, 0.0)
        out[p, 0] = (radial * x + more_x) * lens[0] + lens[2]
        out[p, 1] = (radial * y + more_y) * lens[1] + lens[3]
        if not max(abs(out[p, 0]), abs(out[p, 1])) < _MAX_PIXEL:
            return out[:0]
    return out


@compiled
def deprojected(
    pixels: npt.NDArray[np.float64], z: npt.NDArray[np.float64], lens: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Return pixels ``(P, 2)`` in space, ``(P, 3)`` metres; ``(0, 3)`` without a lens, or if one is not known there."""
    nothing = np.empty((0, 3))
    if len(lens) == 0:
        return nothing
    points = viewing_rays(pixels, lens)
    for p in range(len(points)):
        for d in range(3):
            points[p, d] *= z[p]
            if not np.isfinite(points[p, d]):
                return nothing
    return points


def as_camera_model(camera: CameraLike, size: tuple[int, int] | None = None) -> CameraModel | None:
    """Return the camera model that a camera in any of these forms describes; None stays None.

    Args:
        camera: A ``CameraModel`` or ``Intrinsics``, or their mappings; librealsense's ``rs.intrinsics``; a ROS
            ``CameraInfo``, as a message or a mapping, of an image that is not rectified; OpenCV's K, a 3 x 3 matrix, or
            ``(K, D)`` with the distortion coefficients, or ``(K, D, (width, height))``.
        size: ``(H, W)`` of the images, for a K without a size.

    Raises:
        TypeError: It is none of these.
        ValueError: A value is missing or out of range, or the lens model is not one of ``Intrinsics``.
    """
    if camera is None or isinstance(camera, CameraModel):
        return camera
    if not isinstance(camera, Mapping) or "intrinsics" not in camera:
        return CameraModel(as_intrinsics(camera, size))
    for name in camera:
        if name not in (known := ("intrinsics", "transform_camera_to_base")):
            raise SpecError(f"camera: unknown field {name!r}{did_you_mean(name, known)}")
    return CameraModel(as_intrinsics(camera["intrinsics"], size), camera.get("transform_camera_to_base"))


def as_intrinsics(camera: CameraLike, size: tuple[int, int] | None = None) -> Intrinsics:
    """Return the intrinsics that a camera without a pose describes, see ``as_camera_model``."""
    return camera if isinstance(camera, Intrinsics) else Intrinsics.from_dict(read_fields(camera, size))


def rigid_transform(values: npt.ArrayLike, what: str) -> npt.NDArray[np.float64]:
    """Return a ``(4, 4)`` rigid transform as an array that is read-only.

    Raises:
        SpecError: It is none; the message begins with ``what``.
    """
    try:
        transform = np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise SpecError(f"{what} must be a rigid (4,4) transform, got {values!r:.200}: {error}") from error
    if fault := _not_rigid(transform):
        raise SpecError(
            f"{what} must be a rigid (4,4) transform (rotation, translation in metres, last row 0 0 0 1), got {fault}:"
            f"\n{transform}"
        )
    transform.setflags(write=False)
    return transform


def _not_rigid(transform: npt.NDArray[np.float64]) -> str:
    """Return what keeps an array from being a rigid transform; empty if it is one."""
    if transform.shape != (4, 4):
        return f"shape {transform.shape}"
    if not (np.abs(transform) <= _MAX_DISTANCE).all():
        return f"NaN, or a number above {_MAX_DISTANCE:g}"
    if not np.allclose(transform[3], (0, 0, 0, 1)):
        return f"the last row {transform[3].tolist()}"
    rotation = transform[:3, :3]
    off = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if off > _ORTHONORMAL:
        rounded = "; were its numbers rounded? Give more digits" if off < _ROUNDED else ""
        return f"a rotation R that is not orthonormal, R R^T is off by {off:.2g}{rounded}"
    return "a mirrored rotation, its determinant is -1" if np.linalg.det(rotation) < 0 else ""


def _as_points(points: npt.ArrayLike, dimension: int, name: str) -> npt.NDArray[np.float64]:
    array = np.asarray(points, dtype=np.float64)
    if array.ndim < 1 or array.shape[-1] != dimension:
        raise ValueError(f"{name}: expected shape (..., {dimension}), got {array.shape}.")
    return array
