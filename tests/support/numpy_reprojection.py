"""Reprojection of depth images in NumPy, as an independent oracle for the compiled loop."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from shape_obs import Intrinsics
from shape_obs_envs.sources.registration import MARGIN

Depth = npt.NDArray[np.uint16]
Metres = npt.NDArray[np.float32]

_UNKNOWN = np.uint16(65535)
_HALF, _LARGEST = np.float32(0.5), np.float32(65535)


def reproject(
    metres: Metres, source: Intrinsics, target: Intrinsics, rotation: npt.ArrayLike, translation: npt.ArrayLike
) -> Depth:
    """Reproject a depth image in metres to an image in millimetres; all footprints of the image at once."""
    corners = np.stack(np.meshgrid(np.arange(source.width + 1), np.arange(source.height + 1)), axis=-1) - 0.5
    rays = np.moveaxis(source.rays(corners) @ (target.matrix @ np.asarray(rotation)).T, -1, 0).astype(np.float32)
    shift = (target.matrix @ np.asarray(translation)).astype(np.float32)
    out = np.full(target.height * target.width, _UNKNOWN)
    values, first, wide, tall = _footprints(metres, rays, shift, target)
    for step, part in _cells(wide, tall, target.width):
        _write_nearest(out, first[part] + step, values[part])
    out[out == _UNKNOWN] = 0
    return out.reshape(target.size)


def _footprints(
    z: Metres, rays: Metres, shift: Metres, target: Intrinsics
) -> tuple[Depth, npt.NDArray[np.intp], Metres, Metres]:
    """Return depth, first pixel (flat) and extent of the pixels that land in the target."""
    (across, down, away), (a, b, c) = rays, shift
    height, width = target.size
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # unknown depth is left out below
        begin, end = z * away[:-1, :-1] + c, z * away[1:, 1:] + c
        left = np.maximum(np.ceil((z * across[:-1, :-1] + a) / begin - MARGIN), np.float32(0))
        right = np.minimum(np.ceil((z * across[1:, 1:] + a) / end + MARGIN), np.float32(width)) - np.float32(1)
        top = np.maximum(np.ceil((z * down[:-1, :-1] + b) / begin - MARGIN), np.float32(0))
        bottom = np.minimum(np.ceil((z * down[1:, 1:] + b) / end + MARGIN), np.float32(height)) - np.float32(1)
        values = np.floor((begin + end) * _HALF * np.float32(1 / 0.001) + _HALF)
        inside = (z > 0) & (left <= right) & (top <= bottom) & (values >= 1) & (values < _LARGEST)
    left, top = left[inside], top[inside]
    first = (top * np.float32(width) + left).astype(np.intp)
    return values[inside].astype(np.uint16), first, right[inside] - left, bottom[inside] - top


def _cells(wide: Metres, tall: Metres, width: int) -> Iterator[tuple[int, npt.NDArray[np.bool_]]]:
    """Yield each offset from the first pixel, and which footprints reach that far."""
    for right in range(int(wide.max()) + 1):
        for down in range(int(tall.max()) + 1):
            yield down * width + right, (wide >= right) & (tall >= down)


def _write_nearest(out: Depth, at: npt.NDArray[np.intp], values: Depth) -> None:
    """Write values where they are nearer than the present ones. Each round makes a pixel nearer, so the loop ends."""
    while len(at):
        nearer = values < out[at]
        at, values = at[nearer], values[nearer]
        out[at] = values  # of several values for one pixel the last one stays; the others follow in later rounds
