"""RawImages: what a camera would have given, of the ideal images of a simulator; the reverse of Registration."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics
from shape_obs.compiled import Backend
from shape_obs_envs.sources.registration import check_image, check_unit, in_metres, remap_maps, remapped
from shape_obs_envs.sources.splat import Splat, check_pose

_MILLIMETRE: Final = 0.001


class RawImages:
    """Turns aligned pinhole images into the raw images of a camera that stands where they were taken.

    The colour image gets the lens' distortion; depth is carried to the depth camera, beside it. What the given images
    do not show, because they see less far to the side or because something stands before it, is black and 0.

    Args:
        camera: Of the images that will be given; a pinhole.
        colour: Of the raw colour image.
        depth: Of the raw depth image; a pinhole.
        rotation: (3,3), ``p_colour = rotation p_depth + translation``.
        translation: (3,) metres.
        depth_unit: Metres of 1 in the raw depth image.
        backend: What runs the inner loop: ``"auto"``, ``"numpy"`` or ``"numba"``. All give the same pixels.

    Raises:
        ValueError: A camera with distortion where a pinhole is expected, or a pose that is none.
    """

    def __init__(
        self,
        camera: Intrinsics,
        colour: Intrinsics,
        depth: Intrinsics,
        rotation: npt.ArrayLike,
        translation: npt.ArrayLike,
        depth_unit: float = _MILLIMETRE,
        *,
        backend: Backend = "auto",
    ) -> None:
        for name, intrinsics in (("camera", camera), ("depth", depth)):
            if intrinsics.distorted:
                raise ValueError(
                    f"{name}: expected a pinhole, without distortion, got {intrinsics.model} {intrinsics.coeffs}."
                )
        self.camera, self.colour, self.depth = camera, colour, depth
        rotation, translation = check_pose(rotation, translation)
        self._maps = remap_maps(colour, camera)
        self._spread = Splat(
            camera, depth, rotation.T, -rotation.T @ translation, check_unit(depth_unit), backend=backend
        )

    def __call__(
        self, rgb: npt.NDArray[np.uint8], depth: npt.NDArray[Any]
    ) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint16]]:
        """Make one pair of raw images; the arrays that come back are new.

        Args:
            rgb: (H,W,3) uint8 RGB, of ``camera``.
            depth: (H,W) uint16 millimetres or floating metres, of ``camera``; 0 or not finite is invalid.

        Returns:
            Colour (H,W,3) uint8 RGB and depth (H,W) uint16 in ``depth_unit``, 0 invalid, as the sensors give them.

        Raises:
            ValueError: An image of another size or type.
        """
        rgb = check_image(rgb, "rgb", (*self.camera.size, 3), np.uint8)
        floating = np.issubdtype(np.asarray(depth).dtype, np.floating)
        depth = check_image(depth, "depth", self.camera.size, np.asarray(depth).dtype if floating else np.uint16)
        metres = depth.astype(np.float32) if floating else in_metres(depth, _MILLIMETRE)
        return remapped(rgb, self._maps), self._spread(np.ascontiguousarray(metres))
