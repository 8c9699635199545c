"""Markers, calibration, and depth registered to colour, on drawn scenes with known poses."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import product
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from shape_obs.calibration import Board, BoardViews, fit_base, fit_intrinsics, marker_points
from shape_obs.camera import CameraModel, Intrinsics
from shape_obs.markers import MarkersNotSeen, TopView, find_markers
from tests.benchmarks.claim import Claim, Limit
from tests.benchmarks.scenes.tabletop import TOP, Block, marker_scene, photograph, random_pose, rows_of_blocks, see
from tests.benchmarks.tables import Row, joined, median, of, percent, worst
from tests.benchmarks.timing import timed

Array = npt.NDArray[np.float64]
TOUCH_NOISE: Final = 0.0005  # metres, along each axis
_DEPTH_FRAMES: Final = 5  # frames in the median, as in ``calibrate base``
_BOARD_RASTER: Final = 4000  # pixels a metre
_SIZE, _UNIT, _HEIGHT = (640, 480), 0.001, 0.62  # pixels; metres of a unit of depth, and above the table
_TIMEOUT: Final = 2000  # milliseconds


def top(seed: int) -> Row:
    """Find the homography of a table at 0.65 to 0.9 m, tilted by up to 35 degrees, with a D455 at 640 x 480.

    Returns:
        ``found``: whether all four markers were found; ``mm``: errors of positions all over the rectangle; ``ms``: time
        from image to homography.
    """
    scene = marker_scene(seed)
    try:
        view, ms = timed(lambda: TopView.find(scene.rgb, scene.layout))
    except MarkersNotSeen:
        return Row(found=False, mm=[], ms=np.nan)
    places = scene.grid()
    mm = 1e3 * np.linalg.norm(view.to_table(scene.to_pixels(places)) - places, axis=1)
    return Row(found=len(view.seen) == len(scene.layout.ids), mm=mm, ms=ms)


def touch(scene: tuple[bool, int, int]) -> Row:
    """Calibrate extrinsics from the 16 corners of four markers, touched with an error of 0.5 mm along each axis.

    Returns:
        ``rms`` of the residuals, and ``mm``, the errors of positions on the table in the base frame, millimetres.
    """
    depth, seed, i = scene
    rng, drawn = np.random.default_rng((seed, i)), marker_scene(seed + i)
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(None, rng).as_matrix()
    pose[:3, 3] = rng.uniform((0.2, -0.3, 0.5), (0.6, 0.3, 1.0))
    camera = CameraModel(drawn.intrinsics, pose)
    pixels, layout = find_markers(drawn.rgb), drawn.layout
    size = float(np.linalg.norm(layout.array[0, 1] - layout.array[0, 0]))
    images = [drawn.depth(rng) for _ in range(_DEPTH_FRAMES)] if depth else [None]
    frames = [[marker_points(pixels[each], drawn.intrinsics, image, size) for each in layout.ids] for image in images]
    truth = camera.to_base(drawn.to_camera(layout.array).reshape(-1, 3))
    fit = fit_base(np.median(frames, axis=0).reshape(-1, 3), truth + rng.normal(0, TOUCH_NOISE, truth.shape))
    places = drawn.to_camera(drawn.grid())
    off = CameraModel(drawn.intrinsics, fit.extrinsics.matrix).to_base(places) - camera.to_base(places)
    return Row(depth=depth, rms=1e3 * fit.rms, mm=1e3 * np.linalg.norm(off, axis=1))


def _rms(values: Iterable[float]) -> float:
    return float(np.sqrt(np.mean(np.square(list(values)))))


def board(scene: tuple[int, int]) -> Row:
    """Calibrate a camera with 25 views of a board, and check whether wrong projections are reported.

    Returns:
        Errors of the focal length in percent, of the principal point and of the corners (RMS) in pixels; ``good``:
        whether the true projection was accepted; ``reported``: whether each of two wrong ones was reported: 3 % of the
        focal length, and a lens that bends lines.
    """
    rng, drawn = np.random.default_rng(scene), Board()
    focal = rng.uniform(370, 400)
    camera = Intrinsics(640, 480, focal, focal * rng.uniform(0.998, 1.002), *rng.uniform((312, 232), (328, 248)))
    seen = BoardViews(drawn, camera.size)
    for image in board_images(drawn, camera, 25, rng):
        seen.offer(image)
    fit = fit_intrinsics(seen.taken, seen.size, drawn, camera, seen.coverage)
    longer = replace(camera, fx=1.03 * camera.fx, fy=1.03 * camera.fy)
    bent = replace(camera, model="brown_conrady", coeffs=(-0.055, 0.066, 0.0, 0.0, -0.02))
    found = fit.intrinsics
    return Row(
        focal=100 * abs(found.fx / camera.fx - 1),
        centre=float(np.hypot(found.cx - camera.cx, found.cy - camera.cy)),
        rms=fit.rms,
        good=fit.good,
        reported=[not fit_intrinsics(seen.taken, seen.size, drawn, wrong).good for wrong in (longer, bent)],
    )


def board_images(board: Board, camera: Intrinsics, count: int, rng: np.random.Generator) -> Iterable[Any]:
    """Draw the board in different poses, (480, 640, 3) uint8 each."""
    margin = round(0.02 * _BOARD_RASTER)
    drawn = np.pad(board.picture(_BOARD_RASTER), margin, constant_values=255)
    drawn = np.clip(drawn, 20, 235).astype(np.uint8)
    middle = np.array([board.columns, board.rows]) * board.square / 2
    for _ in range(count):
        pose = random_pose(rng, middle, (0.28, 0.5), 45.0, aside=0.16)
        yield photograph(drawn, np.full(2, -0.02), _BOARD_RASTER, pose, camera, rng)


def registered(seed: int) -> Iterator[Row]:
    """Register depth to colour by ours and by ``rs.align`` of librealsense, on the same raw images of a D455.

    Yields:
        ``edges``: distances of the edge pixels of blocks in depth from their true edges in colour, pixels; ``centres``:
        distances of the blocks' centres, deprojected from colour and depth, from the truth, millimetres; ``align`` and
        ``rectify``: milliseconds at 640 x 480, NaN for a step that there is not.
    """
    from shape_obs_envs.sources.realsense.driver import d455_geometry
    from shape_obs_envs.sources.registration import Registration

    d455 = d455_geometry(*_SIZE, _UNIT)
    base, inner = np.eye(4), np.eye(4)  # slightly tilted, looking down; and of depth in the colour camera's frame
    base[:3, :3] = np.diag([1.0, -1, -1]) @ np.asarray(cv2.Rodrigues(np.array([0.06, 0.04, 0.0]))[0])
    base[:3, 3] = 0.02, -0.01, _HEIGHT
    inner[:3, :3], inner[:3, 3] = d455.rotation, d455.translation
    blocks, camera = rows_of_blocks(np.random.default_rng(seed)), CameraModel(d455.colour, base)
    raw_colour = see(blocks, camera)[0]
    metres = see(blocks, CameraModel(d455.depth, base @ inner))[1]
    raw_depth = np.rint(np.nan_to_num(metres) / _UNIT).astype(np.uint16)

    ours = Registration(d455.colour, d455.depth, d455.rotation, d455.translation, d455.depth_unit)
    pinhole = replace(camera, intrinsics=ours.output)
    colour, rectify = _timed_often(lambda: ours.rectify(raw_colour))
    depth, align = _timed_often(lambda: ours.align(raw_depth))
    yield Row(_errors(blocks, pinhole, pinhole, colour, depth), by="ours", align=align, rectify=rectify)
    depth, align = _align_by_librealsense(raw_colour, raw_depth)
    yield Row(_errors(blocks, camera, pinhole, raw_colour, depth), by="librealsense", align=align, rectify=np.nan)


def _align_by_librealsense(colour: npt.NDArray[np.uint8], depth: npt.NDArray[np.uint16]) -> tuple[Any, float]:
    """Pass raw images through a software camera; return depth as ``rs.align`` moves it, and its milliseconds."""
    from shape_obs_envs.sources.realsense import SoftwareD455
    from shape_obs_envs.sources.realsense.driver import librealsense

    camera, rs = SoftwareD455(depth_unit=_UNIT), librealsense()
    pipeline, config, geometry = rs.pipeline(rs.context()), rs.config(), camera.geometry
    for stream, pixels, lens in (
        (rs.stream.depth, rs.format.z16, geometry.depth),
        (rs.stream.color, rs.format.rgb8, geometry.colour),
    ):
        config.enable_stream(stream, lens.width, lens.height, pixels, camera.fps)
    pipeline.set_device(camera.device)
    pipeline.start(config)
    try:
        camera.push_raw(colour, depth)
        arrived, frames = pipeline.try_wait_for_frames(_TIMEOUT)
        if not arrived or frames.size() < 2:
            raise TimeoutError("librealsense did not return the pair of images that was pushed.")
        align = rs.align(rs.stream.color).process
        aligned, milliseconds = _timed_often(lambda: align(frames))
        return np.array(aligned.get_depth_frame().get_data()), milliseconds
    finally:
        pipeline.stop()


def _timed_often(call: Callable[[], Any]) -> tuple[Any, float]:
    times = [timed(call)[1] for _ in range(20)]  # librealsense has few frames, so that results are not kept
    return call(), float(np.median(times))


def _errors(blocks: list[Block], shown: CameraModel, believed: CameraModel, rgb: Any, depth: Any) -> Row:
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
        polygon = outline.astype(np.float32)[:, None]
        edges += [abs(cv2.pointPolygonTest(polygon, (u, v), True)) for u, v in _crossings(on_top & near).tolist()]
        centre = points[coloured & near & (depth > 0)].mean(axis=0)
        centres.append(1e3 * float(np.linalg.norm((centre - block.top_centre)[:2])))
    return Row(edges=edges, centres=centres)


def _crossings(mask: npt.NDArray[np.bool_]) -> Array:
    """Return the midpoints of neighbouring pixels where only one is in the mask, ``(M, 2)`` pixels."""
    across, down = np.argwhere(mask[:, 1:] != mask[:, :-1]), np.argwhere(mask[1:] != mask[:-1])
    off = across[:, ::-1] + np.array([0.5, 0.0]), down[:, ::-1] + np.array([0.0, 0.5])
    return np.concatenate(off, dtype=np.float64)


CLAIMS: Final = (
    Claim(
        "calibration.markers", "Tables seen from above, by four markers.",
        lambda effort: effort.seeds(40), top, (),
        {"tables": len, "found [%]": percent("found"), "on the table, mean [mm]": joined(np.mean, "mm"),
         "on the table, worst [mm]": joined(max, "mm"), "median [ms]": of(median, "ms")},
        limits=(
            Limit("found [%]", at_least=100, unit="%"), Limit("on the table, worst [mm]", at_most=2, unit="mm"),
            Limit("median [ms]", at_most=15, unit="ms"),
        ),
    ),
    Claim(
        "calibration.touches", "Cameras placed by touching markers, with 0.5 mm of noise along each axis.",
        lambda effort: product((True, False), [effort.seed], range(effort.count(20))), touch, ("depth",),
        {"cameras": len, "touches, rms [mm]": of(_rms, "rms"), "touches, worst camera [mm]": of(worst, "rms"),
         "on the table, rms [mm]": joined(_rms, "mm"), "on the table, worst [mm]": joined(max, "mm")},
        limits=(
            Limit("touches, rms [mm]", at_most=1, unit="mm", where={"depth": True}),
            Limit("on the table, rms [mm]", at_most=1, unit="mm"),
        ),
    ),
    Claim(
        "calibration.boards", "Cameras calibrated with 25 views of a board.",
        lambda effort: product([effort.seed], range(effort.count(10))), board, (),
        {"cameras": len, "focal length, worst [%]": of(worst, "focal"), "centre, worst [px]": of(worst, "centre"),
         "corners, rms [px]": of(worst, "rms"), "called good [%]": percent("good"),
         "wrong ones reported [%]": joined(lambda found: 100 * np.mean(found), "reported")},
        limits=(
            Limit("focal length, worst [%]", at_most=0.5, unit="%"), Limit("corners, rms [px]", at_most=0.5, unit="px"),
            Limit("called good [%]", at_least=100, unit="%"), Limit("wrong ones reported [%]", at_least=90, unit="%"),
        ),
    ),
    Claim(
        "calibration.registration", "Depth registered to colour, by ours and by rs.align.",
        lambda effort: effort.seeds(10), registered, ("by",),
        {"scenes": len, "edges, median [px]": joined(np.median, "edges"), "edges, worst [px]": joined(max, "edges"),
         "block centres, worst [mm]": joined(max, "centres"), "align [ms]": of(median, "align"),
         "rectify [ms]": of(median, "rectify")},
        limits=(
            Limit("edges, median [px]", at_most=0.6, unit="px", where={"by": "ours"}),
            Limit("edges, worst [px]", at_most=1.5, unit="px", where={"by": "ours"}),
            Limit("block centres, worst [mm]", at_most=2.5, unit="mm", where={"by": "ours"}),
        ),
        needs=("pyrealsense2",),
    ),
)  # fmt: skip
