"""Register a depth camera's raw images: one pinhole image with a depth for each colour pixel, and the reverse."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics
from shape_obs_envs.sources.depth_reprojection import DepthReprojection, Metres, check_pose
from shape_obs_envs.sources.rectification import Rectification, remap, remap_maps

Images = tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint16]]
_MILLIMETRE: Final = 0.001


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
        colour: Intrinsics,
        depth: Intrinsics,
        rotation: npt.ArrayLike,
        translation: npt.ArrayLike,
        depth_unit: float = _MILLIMETRE,
    ) -> None:
        self.colour, self.depth, self.depth_unit = colour, depth, _check_unit(depth_unit)
        self._rectification = Rectification.of(colour)
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
        camera: Intrinsics,
        colour: Intrinsics,
        depth: Intrinsics,
        rotation: npt.ArrayLike,
        translation: npt.ArrayLike,
        depth_unit: float = _MILLIMETRE,
    ) -> None:
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
