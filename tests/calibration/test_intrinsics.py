"""A camera's projection from a board, and whether a wrong one is reported."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from drawn_frames import record_drawn, run

from shape_obs import Intrinsics, SpecError
from shape_obs.calibration import Board, BoardViews, IntrinsicsFit, fit_intrinsics
from tests.benchmarks.calibration import board_images

BOARD, VIEWED = Board(), Intrinsics(640, 480, 384.2, 385.1, 318.4, 243.7)


@pytest.fixture(scope="module")
def images():
    return list(board_images(BOARD, VIEWED, 16, np.random.default_rng(4)))


@pytest.fixture(scope="module")
def views(images):
    views = BoardViews(BOARD, (480, 640))
    assert [views.offer(image) for image in images].count("") >= 10
    return views


class TestIntrinsics:
    def test_the_camera_is_recovered(self, views):
        fit = fit_intrinsics(views.taken, views.size, BOARD, VIEWED)
        found = fit.intrinsics
        assert (found.fx, found.fy) == pytest.approx((VIEWED.fx, VIEWED.fy), rel=0.005)
        assert (found.cx, found.cy) == pytest.approx((VIEWED.cx, VIEWED.cy), abs=1)
        assert fit.rms < 0.5
        assert fit.good, fit.doubts

    @pytest.mark.parametrize(
        "wrong",
        [
            replace(VIEWED, fx=1.03 * VIEWED.fx, fy=1.03 * VIEWED.fy),
            replace(VIEWED, model="brown_conrady", coeffs=(-0.055, 0.066, 0.0, 0.0, -0.02)),
            replace(VIEWED, fy=0.97 * VIEWED.fy),
        ],
    )
    def test_a_wrong_projection_is_reported(self, views, wrong):
        fit = fit_intrinsics(views.taken, views.size, BOARD, wrong)
        assert not fit.good
        assert "the factory's rays differ" in " ".join(fit.doubts)

    def test_views_must_differ(self, images):
        views = BoardViews(BOARD, (480, 640))
        assert views.offer(images[0]) == ""
        assert "similar to an earlier view" in views.offer(images[0])
        assert "0 corners of the board are visible" in views.offer(np.full((480, 640, 3), 128, np.uint8))
        with pytest.raises(ValueError, match="expected images of 640 x 480 pixels, got 320 x 240"):
            views.offer(np.zeros((240, 320, 3), np.uint8))
        with pytest.raises(ValueError, match="1 different views of the board are too few, at least 6"):
            fit_intrinsics(views.taken, views.size, BOARD)

    def test_of_a_live_camera_the_board_is_held_still(self, images):
        views = BoardViews(BOARD, (480, 640), still=True)
        assert "hold it still" in views.offer(images[0])
        assert "hold it still" in views.offer(images[1])
        assert views.offer(images[1]) == ""

    def test_from_photos(self, tmp_path, images, capsys):
        for i, image in enumerate(images):
            cv2.imwrite(str(tmp_path / f"{i:02d}.png"), image[..., ::-1])
        out = tmp_path / "result" / "intrinsics.json"
        out.parent.mkdir()
        assert run("calibrate", "intrinsics", "--source", tmp_path, "-o", out) == 0
        assert "factory" not in capsys.readouterr().out
        fit = IntrinsicsFit.load(out)
        assert fit.intrinsics.fx == pytest.approx(VIEWED.fx, rel=0.005)
        assert fit.factory is None

    def test_a_recording_shows_whether_the_factory_is_right(self, tmp_path, images, capsys):
        for name, factory, code in (("good", VIEWED, 0), ("bad", replace(VIEWED, fx=400.0, fy=400.0), 1)):
            record_drawn(tmp_path / name, images, factory)
            words = ["calibrate", "intrinsics", "--source", tmp_path / name, "-o", tmp_path / f"{name}.json"]
            assert run(*words) == code
            assert ("doubt" in capsys.readouterr().out) == bool(code)
        fit = IntrinsicsFit.load(tmp_path / "bad.json")
        assert not fit.good

    def test_boards_that_are_none(self):
        with pytest.raises(SpecError, match="at least 3 x 3 squares and 0 < marker < square"):
            Board(marker=0.04)
        with pytest.raises(SpecError, match="need the ids 20 to 69, '4x4_50' has 50"):
            Board(columns=10, rows=10)
