"""Measure the accuracy of markers and calibration on drawn scenes with known poses."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.calibration import Board, BoardViews, fit_base, fit_intrinsics, marker_points
from shape_obs.calibration.intrinsics import IntrinsicsFit
from shape_obs.camera import Intrinsics
from shape_obs.markers import MarkersNotSeen, TopView, find_markers, fourth_marker
from shape_obs.utils.threads import one_thread
from tests.benchmarks.scenes.tabletop import MarkerScene, marker_scene, photograph, random_pose
from tests.benchmarks.tables import Row, at_least, at_most

Array = npt.NDArray[np.float64]

TOUCH_NOISE: Final = 0.0005  # metres, along each axis
_DEPTH_FRAMES: Final = 5  # frames in the median, as in ``calibrate base``
_BOARD_RASTER: Final = 4000  # pixels a metre


def tops(count: int = 40, seed: int = 0) -> Row:
    """Find homographies of tables at 0.65 to 0.9 m, tilted by up to 35 degrees, with a D455 at 640 x 480.

    Returns:
        ``found``: scenes in which all four markers were found; ``worst_mm`` and ``mean_mm``: errors of positions all
        over the rectangles; ``corner_px``: mean error of the markers' corners; ``fourth_px``: largest error of a
        marker's centre that was computed from the other three; ``median_ms`` and ``late_ms``, the 95th percentile: time
        from image to homography.
    """
    scenes = [marker_scene(seed + i) for i in range(count)]
    off: list[Array] = []
    corner: list[Array] = []
    fourth: list[float] = []
    spent: list[float] = []
    found = 0
    with one_thread():
        find_markers(scenes[0].rgb)
        for scene in scenes:
            begin = time.perf_counter()
            try:
                view = TopView.find(scene.rgb, scene.layout)
            except MarkersNotSeen:
                continue
            spent.append(1e3 * (time.perf_counter() - begin))
            places = scene.grid()
            off.append(np.linalg.norm(view.to_table(scene.to_pixels(places)) - places, axis=1))
            if len(view.seen) < len(scene.layout.ids):
                continue
            found += 1
            seen = find_markers(scene.rgb)
            for each, truth in zip(scene.layout.ids, scene.to_pixels(scene.layout.array), strict=True):
                corner.append(np.linalg.norm(seen[each] - truth, axis=1))
                others = {other: seen[other] for other in scene.layout.ids if other != each}
                middle = fourth_marker(others, (0, 1, 2, 3)).mean(axis=0)
                fourth.append(float(np.linalg.norm(middle - truth.mean(axis=0))))
    every = np.concatenate(off)
    return Row(
        scenes=count,
        found=found,
        worst_mm=1e3 * float(every.max()),
        mean_mm=1e3 * float(every.mean()),
        corner_px=float(np.mean(np.concatenate(corner))),
        fourth_px=max(fourth),
        median_ms=float(np.median(spent)),
        late_ms=float(np.percentile(spent, 95)),
    )


def touched(count: int = 20, seed: int = 0, depth: bool = True) -> Row:
    """Calibrate extrinsics from the 16 corners of four markers, touched with an error of 0.5 mm along each axis.

    Args:
        count: Number of calibrations.
        seed: Seed of the scenes.
        depth: Whether the camera has depth, or only the markers' size.

    Returns:
        The RMS of the residuals of all calibrations and of the worst one, and the errors of positions on the table in
        the base frame, in millimetres.
    """
    rms: list[float] = []
    off: list[Array] = []
    number = 0
    for i in range(count):
        rng = np.random.default_rng((seed, i))
        scene = marker_scene(seed + i)
        transform = _somewhere(rng)
        seen = camera_points(scene, rng, depth)
        truth = _moved(scene.to_camera(scene.layout.array).reshape(-1, 3), transform)
        number = len(truth)
        fit = fit_base(seen, truth + rng.normal(0, TOUCH_NOISE, truth.shape))
        rms.append(fit.rms)
        places = scene.to_camera(scene.grid())
        off.append(np.linalg.norm(_moved(places, fit.extrinsics.matrix) - _moved(places, transform), axis=1))
    every = np.concatenate(off)
    return Row(
        placements=count,
        touches=number,
        rms_mm=1e3 * _rms(rms),
        worst_rms_mm=1e3 * max(rms),
        table_rms_mm=1e3 * _rms(every),
        table_worst_mm=1e3 * float(every.max()),
        depth=depth,
    )


def _moved(points: Array, transform: Array) -> Array:
    return points @ transform[:3, :3].T + transform[:3, 3]


def _rms(values: npt.ArrayLike) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def camera_points(scene: MarkerScene, rng: np.random.Generator, depth: bool) -> Array:
    """Return the markers' corners as the camera measures them, (16, 3) metres."""
    seen = find_markers(scene.rgb)
    size = float(np.linalg.norm(scene.layout.array[0, 1] - scene.layout.array[0, 0]))
    images = [scene.depth(rng) for _ in range(_DEPTH_FRAMES)] if depth else [None]
    frames = [
        [marker_points(seen[each], scene.intrinsics, image, size) for each in scene.layout.ids] for image in images
    ]
    return np.median(frames, axis=0).reshape(-1, 3)


def fitted(count: int = 3, seed: int = 0) -> Row:
    """Calibrate cameras of different focal lengths with a board, and check that wrong projections are reported.

    Returns:
        The largest errors of a focal length in percent, of the principal point and of the corners (RMS) in pixels;
        ``good``: cameras whose true projection was accepted; ``reported``: detected wrong projections, 3 % of the focal
        length, or a lens that bends lines.
    """
    board = Board()
    results: list[tuple[Intrinsics, IntrinsicsFit]] = []
    reported = 0
    for i in range(count):
        rng = np.random.default_rng((seed, i))
        focal = rng.uniform(370, 400)
        camera = Intrinsics(640, 480, focal, focal * rng.uniform(0.998, 1.002), *rng.uniform((312, 232), (328, 248)))
        seen = BoardViews(board, camera.size)
        for image in board_images(board, camera, 25, rng):
            seen.offer(image)
        results.append((camera, fit_intrinsics(seen.taken, seen.size, board, camera, seen.coverage)))
        longer = replace(camera, fx=1.03 * camera.fx, fy=1.03 * camera.fy)
        bent = replace(camera, model="brown_conrady", coeffs=(-0.055, 0.066, 0.0, 0.0, -0.02))
        reported += sum(not fit_intrinsics(seen.taken, seen.size, board, wrong).good for wrong in (longer, bent))
    return Row(
        cameras=count,
        focal_percent=100 * max(abs(fit.intrinsics.fx / camera.fx - 1) for camera, fit in results),
        centre_px=max(float(np.hypot(fit.intrinsics.cx - at.cx, fit.intrinsics.cy - at.cy)) for at, fit in results),
        rms_px=max(fit.rms for _, fit in results),
        good=sum(fit.good for _, fit in results),
        reported=reported,
    )


def board_images(board: Board, camera: Intrinsics, count: int, rng: np.random.Generator) -> Iterable[Any]:
    """Draw the board in different poses, (480, 640, 3) uint8 each."""
    margin = round(0.02 * _BOARD_RASTER)
    drawn = np.pad(board.picture(_BOARD_RASTER), margin, constant_values=255)
    drawn = np.clip(drawn, 20, 235).astype(np.uint8)
    middle = np.array([board.columns, board.rows]) * board.square / 2
    origin = np.full(2, -0.02)
    for _ in range(count):
        pose = random_pose(rng, middle, (0.28, 0.5), 45.0, aside=0.16)
        yield photograph(drawn, origin, _BOARD_RASTER, pose, camera, rng)


def targets(top: Row, placed: Row, cameras: Row) -> list[Row]:
    """Compare markers and calibration with their targets."""
    return [
        at_least("tables with all four markers found", 100, 100 * top.found / top.scenes, " %"),
        at_most("worst place on a table", 2, top.worst_mm, " mm"),
        at_most("from image to homography, median", 15, top.median_ms, " ms"),
        at_most("touches with 0.5 mm noise along each axis: rms", 1, placed.rms_mm, " mm"),
        at_most("the same: places on the table, rms", 1, placed.table_rms_mm, " mm"),
        at_most("focal length from a board", 0.5, cameras.focal_percent, " %"),
        at_most("corners of the board: rms", 0.5, cameras.rms_px, " px"),
    ]


def _somewhere(rng: np.random.Generator) -> Array:
    """Draw a camera's pose above a robot's table, ``(4, 4)``."""
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    transform = np.eye(4)
    transform[:3, :3] = turn * np.sign(np.linalg.det(turn))
    transform[:3, 3] = rng.uniform((0.2, -0.3, 0.5), (0.6, 0.3, 1.0))
    return transform
