"""Registration: a depth camera's raw images -> one pinhole image, with depth under every pixel of colour."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics
from shape_obs.compiled import Backend
from shape_obs_envs.sources.splat import Metres, Splat

Images = tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint16]]
Maps = tuple[npt.NDArray[np.int16], npt.NDArray[np.uint16]]
_MILLIMETRE: Final = 0.001


class Registration:
    """Rectifies colour to a pinhole and aligns depth to it.

    librealsense's own ``rs.align`` copies depth to the colour image as it is, and its vector code leaves the lens
    distortion of the colour camera out; whoever then deprojects a pixel as if there were none is wrong by some
    millimetres at arm's length. Here both images become those of one camera without distortion.

    Where the lens saw less than the pinhole does, colour is black; where nobody measured depth, depth is 0. Depth is
    that of the colour camera: its z, not the depth camera's.

    Args:
        colour: Of the raw colour image.
        depth: Of the raw depth image.
        rotation: (3,3), ``p_colour = rotation p_depth + translation``.
        translation: (3,) metres.
        depth_unit: Metres of 1 in the raw depth image.
        backend: What runs the inner loop: ``"auto"``, ``"numpy"`` or ``"numba"``. All give the same pixels.

    Attributes:
        output: Of both resulting images: a pinhole with the colour camera's size, focal lengths and principal point.

    Raises:
        ValueError: The pose is none, or turns one camera against the other by more than 5 degrees.

    Example:
        >>> import numpy as np
        >>> colour = Intrinsics(640, 480, 386.0, 386.0, 320.0, 240.0, "brown_conrady", (-0.05, 0.06, 0, 0, 0))
        >>> depth = Intrinsics(640, 480, 388.0, 388.0, 322.0, 238.0)
        >>> registration = Registration(colour, depth, np.eye(3), (-0.059, 0.0, 0.0), backend="numpy")
        >>> rgb, aligned = registration(np.zeros((480, 640, 3), np.uint8), np.full((480, 640), 620, np.uint16))
        >>> int(aligned[240, 320]), registration.output.distorted
        (620, False)
    """

    def __init__(
        self,
        colour: Intrinsics,
        depth: Intrinsics,
        rotation: npt.ArrayLike,
        translation: npt.ArrayLike,
        depth_unit: float = _MILLIMETRE,
        *,
        backend: Backend = "auto",
    ) -> None:
        self.colour, self.depth, self.depth_unit = colour, depth, check_unit(depth_unit)
        self.output = replace(colour, model="pinhole", coeffs=(0.0,) * 5)
        self._maps = remap_maps(self.output, colour) if colour.distorted else None
        self._align = Splat(depth, self.output, rotation, translation, _MILLIMETRE, backend)

    def __call__(self, colour_raw: npt.NDArray[np.uint8], depth_raw: npt.NDArray[np.uint16]) -> Images:
        """Register one pair of images; the arrays that come back are new.

        Args:
            colour_raw: (H,W,3) uint8 RGB, as the sensor gives it.
            depth_raw: (H,W) uint16 in ``depth_unit``, as the sensor gives it; 0 is invalid.

        Returns:
            RGB (H,W,3) uint8 and depth (H,W) uint16 in millimetres, 0 invalid; both of ``output``.

        Raises:
            ValueError: An image of another size or type.
        """
        return self.rectify(colour_raw), self.align(depth_raw)

    def rectify(self, colour_raw: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """The colour image alone: (H,W,3) uint8 -> (H,W,3) uint8."""
        colour_raw = check_image(colour_raw, "colour_raw", (*self.colour.size, 3), np.uint8)
        return colour_raw.copy() if self._maps is None else remapped(colour_raw, self._maps)

    def align(self, depth_raw: npt.NDArray[np.uint16]) -> npt.NDArray[np.uint16]:
        """The depth image alone: (H,W) uint16 in ``depth_unit`` -> (H,W) uint16 in millimetres."""
        depth_raw = check_image(depth_raw, "depth_raw", self.depth.size, np.uint16)
        return self._align(in_metres(depth_raw, self.depth_unit))


def check_unit(depth_unit: float) -> float:
    """A depth unit [m]."""
    if not 0 < depth_unit < np.inf:
        raise ValueError(f"depth_unit: expected metres of one unit, such as 0.001, got {depth_unit!r}.")
    return float(depth_unit)


def check_image(image: Any, name: str, shape: tuple[int, ...], dtype: Any) -> npt.NDArray[Any]:
    """An image of the size that the intrinsics tell."""
    image = np.asarray(image)
    if image.shape != shape or image.dtype != dtype:
        raise ValueError(
            f"{name}: expected {shape} {np.dtype(dtype)}, as the intrinsics say, got {image.shape} {image.dtype}. "
            "Give the intrinsics of this stream's mode."
        )
    return image


def in_metres(depth: npt.NDArray[np.uint16], unit: float) -> Metres:
    """Depth in a unit -> metres."""
    return np.multiply(depth, np.float32(unit), dtype=np.float32, order="C")


def remap_maps(target: Intrinsics, source: Intrinsics) -> Maps:
    """For each pixel of one camera the pixel of another in the same place, in the fixed-point form of OpenCV."""
    pixels = np.stack(np.meshgrid(np.arange(target.width), np.arange(target.height)), axis=-1)
    at = source.project(target.rays(pixels)).astype(np.float32)
    whole, fraction = cv2.convertMaps(at[..., 0], at[..., 1], cv2.CV_16SC2)
    return np.asarray(whole, np.int16), np.asarray(fraction, np.uint16)


def remapped(image: npt.NDArray[np.uint8], maps: Maps) -> npt.NDArray[np.uint8]:
    """An image where maps say; black where they point outside it."""
    return np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT), np.uint8)
