"""Measure the accuracy of markers and calibration on drawn scenes with known poses."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.bench.synthetic.tabletop import MarkerScene, marker_scene, photograph, random_pose
from shape_obs.bench.tables import Row, at_least, at_most
from shape_obs.calibration import Board, BoardViews, fit_base, fit_intrinsics, marker_points
from shape_obs.calibration.intrinsics import IntrinsicsFit
from shape_obs.camera import Intrinsics
from shape_obs.markers import MarkersNotSeen, TopView, find_markers, fourth_marker
from shape_obs.utils.threads import one_thread

Array = npt.NDArray[np.float64]

TOUCH_NOISE: Final = 0.0005  # metres, along each axis
_DEPTH_FRAMES: Final = 5  # frames of which the median is taken, as in ``calibrate base``
_BOARD_RASTER: Final = 4000  # pixels a metre


class TopViews(NamedTuple):
    """Homographies of tables from above.

    Args:
        scenes: Number of scenes.
        found: Scenes in which all four markers were found.
        worst_mm: The largest error of any position in any rectangle, in millimetres.
        mean_mm: Mean error over all positions and scenes, in millimetres.
        corner_px: Mean error of the markers' corners in pixels.
        fourth_px: Largest error of a marker's centre that was computed from the other three, in pixels.
        median_ms: Median time from image to homography.
        late_ms: The 95th percentile of that time.
    """

    scenes: int
    found: int
    worst_mm: float
    mean_mm: float
    corner_px: float
    fourth_px: float
    median_ms: float
    late_ms: float


class Touched(NamedTuple):
    """Extrinsics that were calibrated by touching markers.

    Args:
        placements: Number of calibrations.
        touches: Touches of each calibration.
        rms_mm: RMS of all residuals in millimetres.
        worst_rms_mm: RMS of the worst calibration.
        table_rms_mm: RMS error of positions on the table in the base frame, in millimetres.
        table_worst_mm: The largest such error.
        depth: Whether the camera had depth, or only the markers' size.
    """

    placements: int
    touches: int
    rms_mm: float
    worst_rms_mm: float
    table_rms_mm: float
    table_worst_mm: float
    depth: bool


class Fitted(NamedTuple):
    """Cameras calibrated with a board.

    Args:
        cameras: Number of cameras.
        focal_percent: The largest error of a focal length in percent.
        centre_px: The largest error of the principal point in pixels.
        rms_px: The largest RMS of the corners in pixels.
        good: Cameras whose true projection was accepted.
        reported: Detected wrong projections: 3 % of the focal length, or a lens that bends lines.
    """

    cameras: int
    focal_percent: float
    centre_px: float
    rms_px: float
    good: int
    reported: int


def tops(count: int = 40, seed: int = 0) -> TopViews:
    """Find homographies of tables at 0.65 to 0.9 m, tilted by up to 35 degrees, with a D455 at 640 x 480."""
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
            truth = dict(zip(scene.layout.ids, scene.to_pixels(scene.layout.array), strict=True))
            corner += [np.linalg.norm(seen[each] - truth[each], axis=1) for each in truth]
            for each in truth:
                others = {other: corners for other, corners in seen.items() if other in truth and other != each}
                middle = fourth_marker(others, (0, 1, 2, 3)).mean(axis=0)
                fourth.append(float(np.linalg.norm(middle - truth[each].mean(axis=0))))
    every = np.concatenate(off)
    return TopViews(
        count,
        found,
        1e3 * float(every.max()),
        1e3 * float(every.mean()),
        float(np.mean(np.concatenate(corner))),
        max(fourth),
        float(np.median(spent)),
        float(np.percentile(spent, 95)),
    )


def touched(count: int = 20, seed: int = 0, depth: bool = True) -> Touched:
    """Calibrate extrinsics from the 16 corners of four markers, touched with an error of 0.5 mm along each axis."""
    rms: list[float] = []
    off: list[Array] = []
    number = 0
    for i in range(count):
        rng = np.random.default_rng((seed, i))
        scene = marker_scene(seed + i)
        transform = _somewhere(rng)
        seen = camera_points(scene, rng, depth)
        truth = scene.to_camera(scene.layout.array).reshape(-1, 3) @ transform[:3, :3].T + transform[:3, 3]
        number = len(truth)
        fit = fit_base(seen, truth + rng.normal(0, TOUCH_NOISE, truth.shape))
        rms.append(fit.rms)
        places = scene.to_camera(scene.grid())
        found = places @ fit.extrinsics.matrix[:3, :3].T + fit.extrinsics.matrix[:3, 3]
        off.append(np.linalg.norm(found - (places @ transform[:3, :3].T + transform[:3, 3]), axis=1))
    every = np.concatenate(off)
    return Touched(
        count,
        number,
        1e3 * float(np.sqrt(np.mean(np.square(rms)))),
        1e3 * max(rms),
        1e3 * float(np.sqrt(np.mean(every**2))),
        1e3 * float(every.max()),
        depth,
    )


def camera_points(scene: MarkerScene, rng: np.random.Generator, depth: bool) -> Array:
    """Return the markers' corners as the camera measures them, (16, 3) metres."""
    seen = find_markers(scene.rgb)
    size = float(np.linalg.norm(scene.layout.array[0, 1] - scene.layout.array[0, 0]))
    images = [scene.depth(rng) for _ in range(_DEPTH_FRAMES)] if depth else [None]
    frames = [
        [marker_points(seen[each], scene.intrinsics, image, size) for each in scene.layout.ids] for image in images
    ]
    return np.median(frames, axis=0).reshape(-1, 3)


def fitted(count: int = 3, seed: int = 0, views: int = 25) -> Fitted:
    """Calibrate cameras of different focal lengths with a board, and check that wrong projections are reported."""
    board = Board()
    results: list[tuple[Intrinsics, IntrinsicsFit]] = []
    reported = 0
    for i in range(count):
        rng = np.random.default_rng((seed, i))
        focal = rng.uniform(370, 400)
        camera = Intrinsics(640, 480, focal, focal * rng.uniform(0.998, 1.002), *rng.uniform((312, 232), (328, 248)))
        seen = BoardViews(board, camera.size)
        for image in board_images(board, camera, views, rng):
            seen.offer(image)
        results.append((camera, fit_intrinsics(seen.taken, seen.size, board, camera, seen.coverage)))
        longer = Intrinsics(640, 480, 1.03 * camera.fx, 1.03 * camera.fy, camera.cx, camera.cy)
        bent = Intrinsics(
            640, 480, camera.fx, camera.fy, camera.cx, camera.cy, "brown_conrady", (-0.055, 0.066, 0.0, 0.0, -0.02)
        )
        for wrong in (longer, bent):
            reported += not fit_intrinsics(seen.taken, seen.size, board, wrong).good
    return Fitted(
        count,
        100 * max(abs(fit.intrinsics.fx / camera.fx - 1) for camera, fit in results),
        max(float(np.hypot(fit.intrinsics.cx - at.cx, fit.intrinsics.cy - at.cy)) for at, fit in results),
        max(fit.rms for _, fit in results),
        sum(fit.good for _, fit in results),
        reported,
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


def targets(top: TopViews, placed: Touched, cameras: Fitted) -> list[Row]:
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
    """Draw a camera's pose above a robot's table, (4, 4)."""
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    transform = np.eye(4)
    transform[:3, :3] = turn * np.sign(np.linalg.det(turn))
    transform[:3, 3] = rng.uniform((0.2, -0.3, 0.5), (0.6, 0.3, 1.0))
    return transform
