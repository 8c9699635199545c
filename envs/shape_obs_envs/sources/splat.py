"""Splat: depth as one camera measured it, as another camera beside it would have.

Forward mapping: every measured pixel is carried over with its whole footprint, and where several land on one pixel the
nearest counts. So there are neither cracks between the pixels of one surface, nor background that shines through a
foreground, and what nobody measured stays unknown.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics
from shape_obs.compiled import Backend, choose

Depth = npt.NDArray[np.uint16]
Metres = npt.NDArray[np.float32]

#: How far a footprint reaches over its pixel [px of the target]. Neighbours on one surface differ a little in depth,
#: from its slope and from noise, and so move apart: by 0.06 px for each millimetre with the D455's 59 mm at 0.62 m.
#: Less leaves cracks in steep surfaces, more makes what stands before others wider than it is.
MARGIN: Final = np.float32(1 / 16)
#: Rows at a time, so that NumPy's temporaries stay in the cache.
_ROWS: Final = 40
_LARGEST: Final = np.float32(65535)
_NOTHING: Final = np.uint16(65535)
_HALF: Final = np.float32(0.5)
#: Footprints are taken as upright rectangles, which they are while the cameras are hardly turned against each other.
_LARGEST_TURN: Final = np.radians(5.0)


class Splat:
    """Carries depth images from one camera to another.

    Args:
        source: Of the camera that measured.
        target: Of the other one; a pinhole.
        rotation: (3,3), ``p_target = rotation p_source + translation``.
        translation: (3,) metres.
        unit: Metres of 1 in what comes out.
        backend: What runs the inner loop; both give the same pixels.

    Raises:
        ValueError: The target is no pinhole, the rotation is none, or turns by more than 5 degrees.
    """

    def __init__(
        self,
        source: Intrinsics,
        target: Intrinsics,
        rotation: npt.ArrayLike,
        translation: npt.ArrayLike,
        unit: float,
        backend: Backend = "auto",
    ) -> None:
        rotation, translation = check_pose(rotation, translation)
        if target.distorted:
            raise ValueError(f"Splat: expected a target without distortion, got {target.model} {target.coeffs}.")
        self.source, self.target, self.unit = source, target, unit
        # u = (z A + a) / (z C + c) for a point at depth z on a ray: linear, with all that depends on the pixel in A, C.
        corners = np.stack(np.meshgrid(np.arange(source.width + 1), np.arange(source.height + 1)), axis=-1) - 0.5
        scaled = source.rays(corners) @ (target.matrix @ rotation).T
        self._rays = np.ascontiguousarray(np.moveaxis(scaled, -1, 0).astype(np.float32))
        self._shift = (target.matrix @ translation).astype(np.float32)
        self._scale = np.float32(1 / unit)
        self._compiled = choose(backend).compiled
        if self._compiled:
            self(np.zeros(source.size, np.float32))  # compiles now, not at the first frame

    def __call__(self, metres: Metres) -> Depth:
        """Carry one image over.

        Args:
            metres: (H,W) float32 of the source; 0 where unknown.

        Returns:
            (H,W) uint16 of the target, in ``unit``; 0 where unknown or out of uint16's range.
        """
        if self._compiled:
            from shape_obs_envs.sources.splat_numba import splat

            return splat(metres, self._rays, self._shift, self._scale, MARGIN, *self.target.size)
        out = np.full(self.target.height * self.target.width, _NOTHING)
        for row in range(0, self.source.height, _ROWS):
            values, first, wide, tall = self._footprints(metres, slice(row, row + _ROWS))
            for step, part in _cells(wide, tall, self.target.width):
                _lay(out, first[part] + step, values[part])
        out[out == _NOTHING] = 0
        return out.reshape(self.target.size)

    def _footprints(self, metres: Metres, rows: slice) -> tuple[Depth, npt.NDArray[np.intp], Metres, Metres]:
        """Of these rows' pixels that land in the target: depth, first pixel (flat), how far they reach beyond it."""
        z = metres[rows]
        across, down, away = self._rays[:, rows.start : rows.stop + 1]
        a, b, c = self._shift
        height, width = self.target.size
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # of unknown depth: left out below
            begin, end = z * away[:-1, :-1] + c, z * away[1:, 1:] + c
            left = np.maximum(np.ceil((z * across[:-1, :-1] + a) / begin - MARGIN), np.float32(0))
            right = np.minimum(np.ceil((z * across[1:, 1:] + a) / end + MARGIN), np.float32(width)) - np.float32(1)
            top = np.maximum(np.ceil((z * down[:-1, :-1] + b) / begin - MARGIN), np.float32(0))
            bottom = np.minimum(np.ceil((z * down[1:, 1:] + b) / end + MARGIN), np.float32(height)) - np.float32(1)
            values = np.floor((begin + end) * _HALF * self._scale + _HALF)
            inside = (z > 0) & (left <= right) & (top <= bottom) & (values >= 1) & (values < _LARGEST)
        left, top = left[inside], top[inside]
        first = (top * np.float32(width) + left).astype(np.intp)
        return values[inside].astype(np.uint16), first, right[inside] - left, bottom[inside] - top


def _cells(wide: Metres, tall: Metres, width: int) -> Iterator[tuple[int, npt.NDArray[np.bool_] | slice]]:
    """The cells of footprints: for each offset from the first pixel, which of them reach that far."""
    if not len(wide):
        return
    for right in range(int(wide.max()) + 1):
        for down in range(int(tall.max()) + 1):
            yield down * width + right, (wide >= right) & (tall >= down) if right or down else slice(None)


def _lay(out: Depth, at: npt.NDArray[np.intp], values: Depth) -> None:
    """Write values where they are nearer than what is there. Each round something gets nearer, so it ends."""
    while len(at):
        nearer = values < out[at]
        at, values = at[nearer], values[nearer]
        out[at] = values  # of several for one pixel the last stays; the others get their turn


def check_pose(
    rotation: npt.ArrayLike, translation: npt.ArrayLike
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """The pose of one camera beside another, as arrays.

    Raises:
        ValueError: It is none, or the cameras are turned against each other by more than 5 degrees.
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
