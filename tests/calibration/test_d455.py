"""Calibration through librealsense: a software D455 with its lens, its baseline and its depth."""

from __future__ import annotations

import camera_scene  # noqa: F401 - skips these tests where there is no librealsense
import numpy as np
import pytest

from shape_obs import TopView, find_markers
from shape_obs.calibration import Board, BoardViews, fit_base, fit_intrinsics, marker_points
from shape_obs_envs.sources import RealSenseSource, SoftwareD455
from shape_obs_envs.sources.registration import RawImages
from tests.benchmarks.calibration import board_images
from tests.benchmarks.scenes.tabletop import LAYOUT, marker_scene

BOARD = Board()
FAR = np.full((480, 640), 700, np.uint16)


@pytest.fixture(scope="module")
def device() -> SoftwareD455:
    return SoftwareD455("455455")


def test_the_factory_projection_holds_for_what_a_source_gives_and_not_for_what_the_sensor_gives(device):
    lens = device.geometry
    bent = RawImages(device.camera, lens.colour, lens.depth, lens.rotation, lens.translation)
    rectified, raw = BoardViews(BOARD, (480, 640)), BoardViews(BOARD, (480, 640))
    with RealSenseSource(device) as source:
        for image in board_images(BOARD, device.camera, 14, np.random.default_rng(4)):
            device.push(image, FAR)
            seen = source.read(5).rgb
            assert seen is not None
            rectified.offer(seen)
            raw.offer(bent(image, FAR)[0])
        good = fit_intrinsics(rectified.taken, rectified.size, BOARD, source.intrinsics, serial=source.serial)
        bad = fit_intrinsics(raw.taken, raw.size, BOARD, source.intrinsics)
    assert good.good, good.doubts
    assert good.intrinsics.fx == pytest.approx(device.camera.fx, rel=0.003)
    assert good.rms < 0.2
    assert good.serial == "455455"
    assert "not rectified" in " ".join(bad.doubts)


def test_a_place_measured_through_the_camera_itself(device):
    scene = marker_scene(3, intrinsics=device.camera)
    rng = np.random.default_rng(0)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    seen, views = [], []
    with RealSenseSource(device) as source:
        assert source.intrinsics is not None
        for _ in range(3):
            device.push(scene.rgb, np.round(1000 * scene.depth(rng)).astype(np.uint16))
            frame = source.read(5)
            assert frame.rgb is not None
            markers = find_markers(frame.rgb)
            views.append(TopView.of(markers, LAYOUT))
            seen.append([marker_points(markers[each], source.intrinsics, frame.depth) for each in LAYOUT.ids])
        truth = scene.to_camera(LAYOUT.array).reshape(-1, 3) @ turn.T + (0.4, 0.1, 0.9)
        touches = truth + rng.normal(0, 0.0005, truth.shape)
        fit = fit_base(np.median(seen, axis=0).reshape(-1, 3), touches, source.intrinsics, source.serial)
    table = scene.to_camera(scene.grid())
    placed = fit.extrinsics.camera(device.camera, "455455").to_base(table)
    assert fit.rms <= 0.0011
    assert np.linalg.norm(placed - (table @ turn.T + (0.4, 0.1, 0.9)), axis=1).max() < 0.0015
    assert np.linalg.norm(views[-1].to_table(scene.to_pixels(scene.grid())) - scene.grid(), axis=1).max() < 0.001
