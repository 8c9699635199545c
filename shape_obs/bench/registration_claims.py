"""How well depth lies under colour: Registration beside librealsense's own alignment, on a scene with known edges."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.synthetic.tabletop import TOP, Block, rows_of_blocks, see
from shape_obs.bench.tables import at_most
from shape_obs.camera import CameraModel
from shape_obs.compiled import Backend

Array = npt.NDArray[np.float64]

_SIZE: Final = 640, 480
_UNIT: Final = 0.001  # metres
_HEIGHT: Final = 0.62  # metres over the table


@dataclass(frozen=True)
class RegistrationError:
    """How far depth is from colour, and blocks from where they stand.

    Args:
        edges: (M,) distance of each edge pixel of a block in depth from the block's true edge in colour [px].
        centres: (B,) distance of each block's centre, deprojected from colour and depth, from the truth [m].
    """

    edges: Array
    centres: Array


def registration_errors(seed: int = 0, backend: Backend = "auto") -> dict[str, RegistrationError]:
    """Errors of "ours" and of "librealsense", ``rs.align`` with the raw colour image, on the same raw images of a D455.

    Args:
        seed: Of the blocks.
        backend: Of our inner loop.

    Raises:
        ImportError: librealsense is missing.
    """
    from shape_obs_envs.sources.librealsense_align import LibrealsenseAlign
    from shape_obs_envs.sources.realsense import SoftwareD455
    from shape_obs_envs.sources.registration import Registration

    scene = _Scene(seed)
    ours = Registration(*scene.geometry, backend=backend)
    pinhole = replace(scene.colour_camera, intrinsics=ours.output)
    theirs = LibrealsenseAlign(SoftwareD455(depth_unit=_UNIT))
    try:
        aligned = theirs(scene.colour, scene.depth)
    finally:
        theirs.close()
    return {
        "ours": _errors(scene.blocks, pinhole, pinhole, *ours(scene.colour, scene.depth)),
        "librealsense": _errors(scene.blocks, scene.colour_camera, pinhole, scene.colour, aligned),
    }


def registration_times(runs: int = 30) -> dict[str, float]:
    """Median milliseconds of each way at 640 x 480, one thread: our parts on either backend, and ``rs.align``."""
    from shape_obs_envs.sources.librealsense_align import LibrealsenseAlign
    from shape_obs_envs.sources.realsense import SoftwareD455
    from shape_obs_envs.sources.registration import Registration

    scene = _Scene(0)
    theirs = LibrealsenseAlign(SoftwareD455(depth_unit=_UNIT))
    numpy, best = (Registration(*scene.geometry, backend=name) for name in ("numpy", "auto"))
    try:
        frames = theirs.pair(scene.colour, scene.depth)
        ways: dict[str, Callable[[], Any]] = {
            "rectify": lambda: best.rectify(scene.colour),
            "align, numpy": lambda: numpy.align(scene.depth),
            "align, auto": lambda: best.align(scene.depth),
            "rs.align": lambda: theirs.align(frames),
        }
        return {name: _median(way, runs) for name, way in ways.items()}
    finally:
        theirs.close()


def registration_table(scenes: int, seed: int = 0) -> list[dict[str, Any]]:
    """Errors over some scenes, ours held against what is asked, and librealsense's beside them."""
    found = [registration_errors(seed + i) for i in range(scenes)]
    edges = {way: np.concatenate([errors[way].edges for errors in found]) for way in found[0]}
    centres = {way: 1e3 * np.concatenate([errors[way].centres for errors in found]) for way in found[0]}
    rows = []
    for way in edges:
        rows += [
            at_most(f"{way}: edges in depth against colour, median", 0.6, float(np.median(edges[way])), " px"),
            at_most(f"{way}: the same, most", 1.5, float(edges[way].max()), " px"),
            at_most(f"{way}: block centres, most", 2.5, float(centres[way].max()), " mm"),
        ]
    return rows


def time_table() -> list[dict[str, Any]]:
    """Median milliseconds, and as a multiple of ``rs.align`` in the same run."""
    times = registration_times()
    return [{"what": what, "ms": ms, "x rs.align": ms / times["rs.align"]} for what, ms in times.items()]


class _Scene:
    """Blocks on a table under a D455 that looks down, a little tilted, and its two raw images."""

    def __init__(self, seed: int) -> None:
        from shape_obs_envs.sources.realsense.d455 import d455_geometry

        d455 = d455_geometry(*_SIZE, _UNIT)
        self.geometry = d455.colour, d455.depth, d455.rotation, d455.translation, d455.depth_unit
        base, inner = np.eye(4), np.eye(4)
        base[:3, :3] = np.diag([1.0, -1, -1]) @ np.asarray(cv2.Rodrigues(np.array([0.06, 0.04, 0.0]))[0])
        base[:3, 3] = 0.02, -0.01, _HEIGHT
        inner[:3, :3], inner[:3, 3] = d455.rotation, d455.translation
        self.blocks = rows_of_blocks(np.random.default_rng(seed))
        self.colour_camera = CameraModel(d455.colour, base)
        self.colour = see(self.blocks, self.colour_camera)[0]
        metres = see(self.blocks, CameraModel(d455.depth, base @ inner))[1]
        self.depth = np.rint(np.nan_to_num(metres) / _UNIT).astype(np.uint16)


def _median(way: Callable[[], Any], runs: int) -> float:
    way()
    spent = []
    for _ in range(runs):
        begin = time.perf_counter()
        way()
        spent.append(1e3 * (time.perf_counter() - begin))
    return float(np.median(spent))


def _errors(
    blocks: list[Block],
    shown: CameraModel,
    believed: CameraModel,
    rgb: npt.NDArray[np.uint8],
    depth: npt.NDArray[np.uint16],
) -> RegistrationError:
    """Of images that ``shown`` made, to whoever deprojects them with ``believed``, which knows of no distortion."""
    height, width = depth.shape
    rows, columns = np.mgrid[:height, :width]
    points = believed.to_base(believed.intrinsics.deproject(np.stack([columns, rows], axis=-1), depth / 1000.0))
    on_top = (depth > 0) & (np.abs(points[..., 2] - blocks[0].size[2]) < blocks[0].size[2] / 2)
    coloured = (rgb == TOP).all(axis=-1)
    edges, centres = [], []
    for block in blocks:
        outline = shown.project_from_base(block.top_outline())
        (left, top), (right, bottom) = outline.min(axis=0), outline.max(axis=0)
        if min(left, top) < 8 or right > width - 9 or bottom > height - 9:
            continue  # not whole in the picture
        near = np.zeros(depth.shape, bool)
        near[int(top) - 6 : int(bottom) + 8, int(left) - 6 : int(right) + 8] = True
        edges += [abs(_from_outline(outline, at)) for at in _crossings(on_top & near)]
        seen = coloured & near & (depth > 0)
        centre = points[seen].mean(axis=0)
        centres.append(np.linalg.norm((centre - block.top_centre)[:2]))
    return RegistrationError(np.array(edges), np.array(centres))


def _crossings(mask: npt.NDArray[np.bool_]) -> Array:
    """(M,2) pixels, half way between each two neighbours of which one is in the mask."""
    across, down = np.argwhere(mask[:, 1:] != mask[:, :-1]), np.argwhere(mask[1:] != mask[:-1])
    return np.concatenate(
        [across[:, ::-1] + np.array([0.5, 0.0]), down[:, ::-1] + np.array([0.0, 0.5])], dtype=np.float64
    )


def _from_outline(outline: Array, at: Array) -> float:
    return cv2.pointPolygonTest(outline.astype(np.float32)[:, None], (float(at[0]), float(at[1])), True)
