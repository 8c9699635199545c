"""Measure how well depth is registered to colour, next to librealsense's alignment, on a scene with known edges."""

from __future__ import annotations

import timeit
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraModel
from tests.benchmarks.scenes.tabletop import TOP, Block, rows_of_blocks, see
from tests.benchmarks.tables import Row, at_most

Array = npt.NDArray[np.float64]

_SIZE: Final = 640, 480
_UNIT: Final = 0.001  # metres
_HEIGHT: Final = 0.62  # metres above the table
_TIMEOUT: Final = 2000  # milliseconds


def registration_errors(seed: int = 0) -> dict[str, Row]:
    """Return the errors of "ours" and of "librealsense" (``rs.align``) on the same raw images of a D455.

    Args:
        seed: Seed of the blocks.

    Returns:
        ``edges``: distances of the edge pixels of blocks in depth from their true edges in colour, ``(M,)`` pixels;
        ``centres``: distances of the blocks' centres, deprojected from colour and depth, from the truth, (B,) metres.

    Raises:
        ImportError: librealsense is not installed.
    """
    from shape_obs_envs.sources.registration import Registration

    scene = _Scene(seed)
    ours = Registration(*scene.geometry)
    pinhole = replace(scene.colour_camera, intrinsics=ours.output)
    with _librealsense() as (pair, align):
        aligned = np.array(align(pair(scene)).get_depth_frame().get_data())
    return {
        "ours": _errors(scene.blocks, pinhole, pinhole, *ours(scene.colour, scene.depth)),
        "librealsense": _errors(scene.blocks, scene.colour_camera, pinhole, scene.colour, aligned),
    }


def registration_table(scenes: int, seed: int = 0) -> list[Row]:
    """Compare the errors over some scenes with their targets, ours first."""
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


def time_table() -> list[Row]:
    """Return median milliseconds of our parts and of ``rs.align`` at 640 x 480, also as multiples of the latter."""
    from shape_obs_envs.sources.registration import Registration

    scene = _Scene(0)
    ours = Registration(*scene.geometry)
    with _librealsense() as (pair, align):
        frames = pair(scene)
        calls: dict[str, Callable[[], Any]] = {
            "rectify": lambda: ours.rectify(scene.colour),
            "align": lambda: ours.align(scene.depth),
            "rs.align": lambda: align(frames),
        }
        times = {
            name: 1e3 * float(np.median(timeit.repeat(call, repeat=31, number=1)[1:])) for name, call in calls.items()
        }
    return [Row({"what": what, "ms": ms, "x rs.align": ms / times["rs.align"]}) for what, ms in times.items()]


@contextmanager
def _librealsense() -> Iterator[tuple[Callable[[_Scene], Any], Callable[[Any], Any]]]:
    """Yield functions of librealsense: from a scene to a frameset, through a software camera, and ``rs.align``."""
    from shape_obs_envs.sources.realsense import SoftwareD455
    from shape_obs_envs.sources.realsense.driver import librealsense

    camera, rs = SoftwareD455(depth_unit=_UNIT), librealsense()
    pipeline, config, geometry = rs.pipeline(rs.context()), rs.config(), camera.geometry
    for stream, pixels, lens in (
        (rs.stream.depth, rs.format.z16, geometry.depth),
        (rs.stream.color, rs.format.rgb8, geometry.colour),
    ):
        config.enable_stream(stream, lens.width, lens.height, pixels, camera.fps)

    def pair(scene: _Scene) -> Any:
        camera.push_raw(scene.colour, scene.depth)
        arrived, frames = pipeline.try_wait_for_frames(_TIMEOUT)
        if not arrived or frames.size() < 2:
            raise TimeoutError("librealsense did not return the pair of images that was pushed.")
        return frames

    pipeline.set_device(camera.device)
    pipeline.start(config)
    try:
        yield pair, rs.align(rs.stream.color).process
    finally:
        pipeline.stop()


class _Scene:
    """Blocks on a table under a slightly tilted D455 that looks down, and its two raw images."""

    def __init__(self, seed: int) -> None:
        from shape_obs_envs.sources.realsense.driver import d455_geometry

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


def _errors(
    blocks: list[Block],
    shown: CameraModel,
    believed: CameraModel,
    rgb: npt.NDArray[np.uint8],
    depth: npt.NDArray[np.uint16],
) -> Row:
    """Return the errors of images of the camera ``shown`` that are deprojected with the pinhole camera ``believed``."""
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
            continue  # not completely in the image
        near = np.zeros(depth.shape, bool)
        near[int(top) - 6 : int(bottom) + 8, int(left) - 6 : int(right) + 8] = True
        edges += [abs(_from_outline(outline, at)) for at in _crossings(on_top & near)]
        seen = coloured & near & (depth > 0)
        centre = points[seen].mean(axis=0)
        centres.append(np.linalg.norm((centre - block.top_centre)[:2]))
    return Row(edges=np.array(edges), centres=np.array(centres))


def _crossings(mask: npt.NDArray[np.bool_]) -> Array:
    """Return the midpoints of neighbouring pixels where only one is in the mask, ``(M, 2)`` pixels."""
    across, down = np.argwhere(mask[:, 1:] != mask[:, :-1]), np.argwhere(mask[1:] != mask[:-1])
    off = across[:, ::-1] + np.array([0.5, 0.0]), down[:, ::-1] + np.array([0.0, 0.5])
    return np.concatenate(off, dtype=np.float64)


def _from_outline(outline: Array, at: Array) -> float:
    return cv2.pointPolygonTest(outline.astype(np.float32)[:, None], (float(at[0]), float(at[1])), True)
