"""RealSenseSource on a software D455: frames, timing and options."""

from __future__ import annotations

import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from camera_scene import arrived, camera, numbers, picture, smooth, source, streaming

from shape_obs.source import RGBDSource, SourceError
from shape_obs_envs.sources import RealSenseSource, SoftwareD455


def test_ideal_images_come_out_as_they_were_put_in() -> None:
    device, (rgb, depth) = SoftwareD455(), smooth()
    with RealSenseSource(device) as stream:
        device.push(rgb, depth)
        frame = stream.read(5)
        assert isinstance(stream, RGBDSource)
    assert frame.camera is not None
    assert not frame.camera.intrinsics.distorted
    assert np.allclose(frame.camera.intrinsics.matrix, device.camera.matrix, atol=1e-4)
    assert frame.rgb is not None
    assert frame.depth is not None
    inner = np.s_[40:-40, 80:-40]
    assert np.abs(frame.rgb[inner].astype(float) - rgb[inner]).mean() < 1
    assert np.median(np.abs(frame.depth[inner].astype(float) - 700)) <= 1


def test_a_slow_reader_gets_every_frame() -> None:
    device = camera()
    with source(device, buffer=64) as stream, streaming(device, 0.005, count=60):
        assert numbers(stream, 60, pause=0.01) == list(range(1, 61))
        assert stream.dropped == 0


@pytest.mark.parametrize("stamp", [None, 12.5])
def test_a_fresh_frame_shows_what_was_done_before_the_call(stamp: float | None) -> None:
    device = camera()
    with source(device) as stream:
        for _ in range(3):
            arrived(stream, device.push_raw(*picture(), stamp))
        time.sleep(0.01)  # librealsense reports arrivals in whole milliseconds
        later = threading.Timer(0.1, device.push_raw, picture(1), {"stamp": stamp and stamp + 1})
        later.start()
        assert stream.read(5, fresh=True).number == 4
        later.join()


def test_options_are_set() -> None:
    device = camera()
    options = {"exposure": 0.008, "gain": 32, "white_balance": 4000, "laser_power": 150, "preset": "high_accuracy"}
    with source(device, **options):
        colour = [
            device.option("colour", name) for name in ("exposure", "gain", "white_balance", "global_time_enabled")
        ]
        assert colour == [80, 32, 4000, 1]
        assert (
            device.option("colour", "enable_auto_exposure") == device.option("colour", "enable_auto_white_balance") == 0
        )
        assert device.option("depth", "laser_power") == 150
        assert device.option("depth", "visual_preset") == 3
    with source(device, laser_power=0):
        assert device.option("depth", "emitter_enabled") == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"exposure": 20.0}, r"D455 455 \(USB 3\.2\): exposure 20\.0 s: expected 0\.0001 to 1 "),
        ({"white_balance": 100}, r"white_balance 100 K: expected 2800 to 6500"),
        ({"laser_power": 999}, r"laser_power 999 mW: expected 0 to 360"),
        ({"width": 640, "height": 480}, r"has no 640 x 480 at 30 .* it has 160 x 120 at 30"),
    ],
)
def test_what_the_camera_cannot_do_is_reported(options: dict, message: str) -> None:
    device = camera()
    with pytest.raises(SourceError, match=message) as error:
        source(device, **options).connect()
    assert (error.value.serial, error.value.usb) == ("455", "3.2")
    with source(device):  # it is not left in use
        pass


def test_a_missing_mode_on_usb_2_is_reported() -> None:
    with pytest.raises(SourceError, match="USB 3 port"):
        source(camera(usb="2.1"), fps=90).connect()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gain": 20}, "give exposure in seconds"),
        ({"preset": "best"}, "preset: expected one of 'default'.*got 'best'"),
        ({"filters": ("decimation",)}, "choose a smaller stream"),
        ({"filters": ("median",)}, "expected 'temporal'.*got 'median'"),
        ({"filters": (("temporal", {"sigma": 1}),)}, "has the parameters alpha, delta, persistence"),
        ({"filters": "temporal"}, "expected a sequence"),
        ({"buffer": 0}, "buffer: expected more than 0"),
        ({"recording": "x.db3", "serial": "1"}, "instead of a camera"),
    ],
)
def test_arguments_that_make_no_sense(options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        RealSenseSource(**options)


def test_filters_run(caplog: pytest.LogCaptureFixture) -> None:
    device, (rgb, _) = camera(), picture()
    depth = np.full((120, 160), 700, np.uint16)
    depth[:, 80:] = 1500
    with source(device, filters=(("threshold", {"max_distance": 1.0}), "temporal", "hole_filling")) as stream:
        assert "invents depth" in caplog.text
        device.push_raw(rgb, depth)
        assert stream.read(5).depth is not None
    with source(device, filters=(("threshold", {"max_distance": 1.0}),)) as stream:
        device.push_raw(rgb, depth)
        frame = stream.read(5)
    assert frame.depth is not None
    assert frame.depth.max() < 1000
    assert np.median(frame.depth[:, 20:70]) == pytest.approx(700, abs=2)
    with pytest.raises(ValueError, match=r"alpha must be 0 to 1, got 2"):
        source(device, filters=(("temporal", {"alpha": 2}),)).connect()


def test_librealsense_is_loaded_when_a_camera_is_opened_and_missed_by_name() -> None:
    code = (
        "import sys, shape_obs_envs, shape_obs_envs.sources.realsense as r\n"
        "assert 'pyrealsense2' not in sys.modules\n"
        "sys.modules['pyrealsense2'] = None\n"
        "r.RealSenseSource(serial='1').connect()"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "ImportError: RealSense cameras and their recordings need librealsense" in ran.stderr
    assert 'pip install ".[realsense]"' in ran.stderr
