"""Reproject depth images from one camera to another camera next to it.

The mapping is a forward one. Each measured pixel covers its whole footprint in the target image, and the nearest depth
wins where footprints overlap. The result has no cracks within a surface and no background that shows through a
foreground object. Pixels that were not measured stay unknown.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt
from numba import njit

from shape_obs.camera import Intrinsics

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
        source: Intrinsics,
        target: Intrinsics,
        rotation: npt.ArrayLike,
        translation: npt.ArrayLike,
        unit: float,
    ) -> None:
        rotation, translation = check_pose(rotation, translation)
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


@njit(cache=True, nogil=True, error_model="numpy")
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
    turn = np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))
    if turn > _LARGEST_TURN:
        raise ValueError(
            f"the depth camera is turned against the colour camera by {np.degrees(turn):.1f} degrees; expected two "
            "cameras side by side, within 5 degrees."
        )
    return rotation, translation
