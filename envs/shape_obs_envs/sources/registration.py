"""Register a depth camera's raw images: one pinhole image with a depth for each colour pixel, and the reverse.

The mapping of depth is a forward one. Each measured pixel covers its whole footprint in the target image, and the
nearest depth wins where footprints overlap. The result has no cracks within a surface and no background that shows
through a foreground object. Pixels that were not measured stay unknown.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraLike, Intrinsics, as_intrinsics
from shape_obs.compiled import compiled
from shape_obs.utils.lengths import warn_unless_metres
from shape_obs_envs.sources.rectification import Rectification, remap, remap_maps

Images = tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint16]]
_MILLIMETRE: Final = 0.001

Depth = npt.NDArray[np.uint16]
Metres = npt.NDArray[np.float32]

#: Overlap of a footprint beyond its pixel, in target pixels. Neighbouring pixels of one surface differ in depth because
#: of slope and noise, so they move apart: by 0.06 px per millimetre with the D455's 59 mm baseline at 0.62 m. A smaller
#: margin leaves cracks in steep surfaces; a larger one widens foreground objects.
MARGIN: Final = np.float32(1 / 16)
#: Footprints are treated as axis-aligned rectangles, which holds while the cameras are nearly parallel.
_LARGEST_TURN: Final = np.radians(5.0)
_ZERO, _HALF, _ONE = np.float32(0), np.float32(0.5), np.float32(1)
_LARGEST: Final = np.float32(65535)
_UNKNOWN: Final = np.uint16(65535)  # during the computation; 0 in the result


class Registration:
    """Rectify colour images to a pinhole camera and align depth images to them.

    librealsense's own ``rs.align`` copies depth onto the distorted colour image, and its vectorised code ignores the
    distortion of the colour lens. Deprojecting such a pixel with the pinhole model is wrong by several millimetres at
    arm's length. Here both images become those of one camera without distortion.

    Colour is black where the lens sees less than the pinhole camera does. Depth is 0 where it was not measured, and is
    the z coordinate of the colour camera, not of the depth camera.

    Args:
        colour: Intrinsics of the raw colour image.
        depth: Intrinsics of the raw depth image.
        rotation: Rotation matrix of shape ``(3, 3)``, ``p_colour = rotation p_depth + translation``.
        translation: Translation of shape ``(3,)``, in metres.
        depth_unit: Unit of the raw depth image, in metres.

    Attributes:
        output: Intrinsics of both results: a pinhole with the colour camera's size, focal lengths and principal point.

    Raises:
        ValueError: The pose is invalid, or turns one camera against the other by more than 5 degrees.

    Example:
        >>> import numpy as np
        >>> lens = "brown_conrady", (-0.05, 0.06, 0, 0, 0)
        >>> colour = Intrinsics(640, 480, 386.0, 386.0, 320.0, 240.0, *lens)
        >>> depth = Intrinsics(640, 480, 388.0, 388.0, 322.0, 238.0)
        >>> registration = Registration(colour, depth, np.eye(3), (-0.059, 0.0, 0.0))
        >>> rgb, depth = np.zeros((480, 640, 3), np.uint8), np.full((480, 640), 620, np.uint16)
        >>> rgb, aligned = registration(rgb, depth)
        >>> int(aligned[240, 320]), registration.output.distorted
        (620, False)
    """

    output: Intrinsics

    def __init__(
        self,
        colour: CameraLike,
        depth: CameraLike,
        rotation: npt.ArrayLike,
        translation: npt.ArrayLike,
        depth_unit: float = _MILLIMETRE,
    ) -> None:
        self.colour, self.depth, self.depth_unit = as_intrinsics(colour), as_intrinsics(depth), _check_unit(depth_unit)
        self._rectification = Rectification.of(self.colour)
        self.output = self._rectification.output
        self._reproject = DepthReprojection(depth, self.output, rotation, translation, _MILLIMETRE)

    def __call__(self, colour_raw: npt.NDArray[np.uint8], depth_raw: npt.NDArray[np.uint16]) -> Images:
        """Register one pair of images.

        Args:
            colour_raw: Colour image of the sensor, shape ``(H, W, 3)``, uint8 RGB.
            depth_raw: Depth image of the sensor, shape ``(H, W)``, uint16 in ``depth_unit``; 0 is invalid.

        Returns:
            New arrays, RGB ``(H, W, 3)`` uint8 and depth ``(H, W)`` uint16 in millimetres, 0 where invalid; both have
            the intrinsics ``output``.

        Raises:
            ValueError: An image has another size or type.
        """
        return self.rectify(colour_raw), self.align(depth_raw)

    def rectify(self, colour_raw: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """Rectify a raw colour image of shape ``(H, W, 3)``."""
        colour_raw = _check_image(colour_raw, "colour_raw", (*self.colour.size, 3), np.uint8)
        rectified = self._rectification.colour(colour_raw)
        return rectified.copy() if rectified is colour_raw else rectified

    def align(self, depth_raw: npt.NDArray[np.uint16]) -> npt.NDArray[np.uint16]:
        """Align a raw depth image of shape ``(H, W)``; the result is in millimetres."""
        depth_raw = _check_image(depth_raw, "depth_raw", self.depth.size, np.uint16)
        return self._reproject(_in_metres(depth_raw, self.depth_unit))


class RawImages:
    """Turn aligned pinhole images, such as a simulator's, into the raw images of a camera in the same place.

    This is the reverse of ``Registration``. The colour image gets the distortion of the lens; depth is reprojected to
    the depth camera. Parts that the given images do not show, because they lie outside the view or are occluded, are
    black and have depth 0.

    Args:
        camera: Intrinsics of the given images, a pinhole.
        colour: Intrinsics of the raw colour image.
        depth: Intrinsics of the raw depth image, a pinhole.
        rotation: Rotation matrix of shape ``(3, 3)``, ``p_colour = rotation p_depth + translation``.
        translation: Translation of shape ``(3,)``, in metres.
        depth_unit: Unit of the raw depth image, in metres.

    Raises:
        ValueError: A camera has distortion where a pinhole is expected, or the pose is invalid.
    """

    def __init__(
        self,
        camera: CameraLike,
        colour: CameraLike,
        depth: CameraLike,
        rotation: npt.ArrayLike,
        translation: npt.ArrayLike,
        depth_unit: float = _MILLIMETRE,
    ) -> None:
        camera, colour, depth = (as_intrinsics(each) for each in (camera, colour, depth))
        for name, intrinsics in (("camera", camera), ("depth", depth)):
            if intrinsics.distorted:
                raise ValueError(
                    f"{name}: expected a pinhole, without distortion, got {intrinsics.model} {intrinsics.coeffs}."
                )
        self.camera, self.colour, self.depth = camera, colour, depth
        rotation, translation = check_pose(rotation, translation)
        self._maps = remap_maps(colour, camera)
        self._reproject = DepthReprojection(
            camera, depth, rotation.T, -rotation.T @ translation, _check_unit(depth_unit)
        )

    def __call__(self, rgb: npt.NDArray[np.uint8], depth: npt.NDArray[Any]) -> Images:
        """Make one pair of raw images.

        Args:
            rgb: Colour image of ``camera``, shape ``(H, W, 3)``, uint8 RGB.
            depth: Depth image of ``camera``, shape ``(H, W)``, in uint16 millimetres or floating-point metres; values
                that are 0 or not finite are invalid.

        Returns:
            New arrays as the sensors deliver them, colour ``(H, W, 3)`` uint8 RGB and depth ``(H, W)`` uint16 in
            ``depth_unit``, 0 where invalid.

        Raises:
            ValueError: An image has another size or type.
        """
        rgb = _check_image(rgb, "rgb", (*self.camera.size, 3), np.uint8)
        floating = np.issubdtype(np.asarray(depth).dtype, np.floating)
        depth = _check_image(depth, "depth", self.camera.size, np.asarray(depth).dtype if floating else np.uint16)
        metres = depth.astype(np.float32) if floating else _in_metres(depth, _MILLIMETRE)
        return remap(rgb, self._maps), self._reproject(np.ascontiguousarray(metres))


def _check_unit(depth_unit: float) -> float:
    if not 0 < depth_unit < np.inf:
        raise ValueError(f"depth_unit: expected metres of one unit, such as 0.001, got {depth_unit!r}.")
    return float(depth_unit)


def _check_image(image: Any, name: str, shape: tuple[int, ...], dtype: Any) -> npt.NDArray[Any]:
    image = np.asarray(image)
    if image.shape != shape or image.dtype != dtype:
        raise ValueError(
            f"{name}: expected {shape} {np.dtype(dtype)}, as given by the intrinsics, got {image.shape} {image.dtype}. "
            "Pass the intrinsics of this stream's mode."
        )
    return image


def _in_metres(depth: npt.NDArray[np.uint16], unit: float) -> Metres:
    return np.multiply(depth, np.float32(unit), dtype=np.float32, order="C")


class DepthReprojection:
    """Reproject depth images from a source camera to a target camera.

    Args:
        source: Intrinsics of the camera that measured the depth.
        target: Intrinsics of the other camera, a pinhole.
        rotation: Rotation matrix of shape ``(3, 3)``, ``p_target = rotation p_source + translation``.
        translation: Translation of shape ``(3,)``, in metres.
        unit: Depth unit of the result, in metres.

    Raises:
        ValueError: The target has distortion, or the pose is invalid or turns by more than 5 degrees.
    """

    def __init__(
        self,
        source: CameraLike,
        target: CameraLike,
        rotation: npt.ArrayLike,
        translation: npt.ArrayLike,
        unit: float,
    ) -> None:
        rotation, translation = check_pose(rotation, translation)
        source, target = as_intrinsics(source), as_intrinsics(target)
        if target.distorted:
            raise ValueError(
                f"DepthReprojection: expected a target without distortion, got {target.model} {target.coeffs}."
            )
        self.source, self.target, self.unit = source, target, unit
        # u = (z A + a) / (z C + c) for a point at depth z on a ray: everything that depends on the pixel is in A and C.
        corners = np.stack(np.meshgrid(np.arange(source.width + 1), np.arange(source.height + 1)), axis=-1) - 0.5
        scaled = source.rays(corners) @ (target.matrix @ rotation).T
        self._rays = np.ascontiguousarray(np.moveaxis(scaled, -1, 0).astype(np.float32))
        self._shift = (target.matrix @ translation).astype(np.float32)
        self._scale = np.float32(1 / unit)
        self(np.zeros(source.size, np.float32))  # compile now, not at the first frame

    def __call__(self, metres: Metres) -> Depth:
        """Reproject one depth image.

        Args:
            metres: Depth image of the source, shape ``(H, W)``, float32 in metres; 0 where unknown.

        Returns:
            Depth image of the target, uint16 in ``unit``; 0 where unknown or outside the range of uint16.
        """
        return reproject(metres, self._rays, self._shift, self._scale, MARGIN, *self.target.size)


@compiled("(f4[:,::1], f4[:,:,::1], f4[::1], f4, f4, i8, i8)", division=True)
def reproject(metres: Metres, rays: Metres, shift: Metres, scale: Any, margin: Any, height: int, width: int) -> Depth:
    """Reproject a depth image to an image of ``height`` by ``width`` pixels.

    Args:
        metres: Depth image of shape ``(H, W)``, in metres; 0 where unknown.
        rays: Rays through the pixel corners, multiplied by the target's projection, shape ``(3, H + 1, W + 1)``.
        shift: Projected translation, shape ``(3,)``.
        scale: Target depth units per metre.
        margin: Overlap of a footprint beyond its pixel, in target pixels.
        height: Height of the target image in pixels.
        width: Width of the target image in pixels.

    Returns:
        Depth image of shape ``(height, width)``, uint16; 0 where unknown.
    """
    out = np.full((height, width), _UNKNOWN)
    columns = metres.shape[1]
    value = np.empty(columns, np.uint16)
    left, right = np.empty(columns, np.int32), np.empty(columns, np.int32)
    top, bottom = np.empty(columns, np.int32), np.empty(columns, np.int32)
    a, b, c = shift[0], shift[1], shift[2]
    high, wide = np.float32(height), np.float32(width)
    for row in range(metres.shape[0]):
        for i in range(columns):  # no branches, so that the compiler can vectorise the loop
            z = metres[row, i]
            begin = z * rays[2, row, i] + c
            end = z * rays[2, row + 1, i + 1] + c
            near = np.floor((begin + end) * _HALF * scale + _HALF)
            known = (z > _ZERO) & (near >= _ONE) & (near < _LARGEST)
            x0 = np.ceil((z * rays[0, row, i] + a) / begin - margin)
            x1 = np.ceil((z * rays[0, row + 1, i + 1] + a) / end + margin)
            y0 = np.ceil((z * rays[1, row, i] + b) / begin - margin)
            y1 = np.ceil((z * rays[1, row + 1, i + 1] + b) / end + margin)
            # Clip to the image. Comparisons in this order turn NaN into an empty footprint.
            x0, y0 = x0 if x0 < wide else wide, y0 if y0 < high else high
            x1, y1 = x1 if x1 > _ZERO else _ZERO, y1 if y1 > _ZERO else _ZERO
            left[i] = np.int32(x0 if x0 > _ZERO else _ZERO)
            top[i] = np.int32(y0 if y0 > _ZERO else _ZERO)
            right[i] = np.int32((x1 if x1 < wide else wide) if known else _ZERO)
            bottom[i] = np.int32(y1 if y1 < high else high)
            value[i] = np.uint16(near if known else _ZERO)
        for i in range(columns):
            for v in range(top[i], bottom[i]):
                for u in range(left[i], right[i]):
                    if value[i] < out[v, u]:
                        out[v, u] = value[i]
    for v in range(height):
        for u in range(width):
            if out[v, u] == _UNKNOWN:
                out[v, u] = 0
    return out


def check_pose(
    rotation: npt.ArrayLike, translation: npt.ArrayLike
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return the relative pose of two cameras as arrays.

    Raises:
        ValueError: It is not a pose, or the cameras are turned against each other by more than 5 degrees.
    """
    rotation, translation = np.asarray(rotation, np.float64), np.asarray(translation, np.float64)
    if rotation.shape != (3, 3) or translation.shape != (3,):
        raise ValueError(
            f"expected a (3,3) rotation and a (3,) translation in metres, got {rotation.shape} and {translation.shape}."
        )
    finite = np.isfinite(translation).all()
    if not (finite and np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4) and np.linalg.det(rotation) > 0):
        raise ValueError(
            f"expected a rotation matrix and a finite translation in metres, got {rotation} and {translation}. "
            "librealsense lists a rotation column by column: np.reshape(extrinsics.rotation, (3, 3)).T"
        )
    warn_unless_metres("translation", translation, most=1.0, stacklevel=4)
    turn = np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))
    if turn > _LARGEST_TURN:
        raise ValueError(
            f"the depth camera is turned against the colour camera by {np.degrees(turn):.1f} degrees; expected two "
            "cameras side by side, within 5 degrees."
        )
    return rotation, translation
