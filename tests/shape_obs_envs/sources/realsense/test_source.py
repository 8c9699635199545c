"""RealSenseSource on a software D455: frames, options, and no old image from a camera that freezes or disappears."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from camera_scene import arrived, camera, numbers, picture, smooth, source, streaming
from fake_cell import ROPE, FakeRobot, make_env

from shape_obs import ShapeObservation
from shape_obs.source import CameraLost, CameraNotFound, FrameTimeout, RGBDSource, SourceError
from shape_obs.utils.timing import CLOCK
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
        ({"filters": (("temporal", {"sigma": 1}),)}, "has the parameters alpha, delta, persistence"),
        ({"buffer": 0}, "buffer: expected more than 0"),
        ({"fps": 29.97}, "fps: expected a whole number"),
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


# ---- a camera that freezes, loses or delays frames, is unplugged or missing


@pytest.mark.parametrize("stream_name", ["colour", "depth"])
def test_a_frozen_stream_never_yields_a_frame(stream_name: str) -> None:
    device = camera()
    freeze = device.freeze_colour if stream_name == "colour" else device.freeze_depth
    with source(device) as stream:
        device.push_raw(*picture())
        assert stream.read(5).number == 1
        freeze()
        for _ in range(30):
            device.push_raw(*picture())
        with pytest.raises(
            FrameTimeout, match=f"455 .*pairs were refused since: the {stream_name} image was an old one"
        ):
            stream.read(0.5)
        freeze(False)
        assert device.push_raw(*picture()) == stream.read(5).number == 32


def test_colour_that_lags_behind_depth_never_yields_a_frame() -> None:
    """Both images are new, but were not taken at the same time."""
    device = camera()
    with source(device, max_gap=0.0) as stream:
        arrived(stream, device.push_raw(*picture(), 1.0))
    with source(device) as stream:
        device.freeze_depth()
        device.push_raw(*picture(), 2.0)
        device.freeze_depth(False)
        device.freeze_colour()
        for number in range(12):
            device.push_raw(*picture(), 2.1 + number / 30)
        with pytest.raises(FrameTimeout):
            stream.read(0.5)


def test_a_lost_frame_leaves_a_gap() -> None:
    device = camera()
    with source(device) as stream:
        found = []
        for index in range(6):
            if index == 2:
                device.drop(2)
            device.push_raw(*picture())
            if index not in (2, 3):
                found += numbers(stream, 1)
        assert found == [1, 2, 5, 6]


@pytest.mark.parametrize("timeout", [0.0, 0.1, 0.4])
def test_a_timeout_is_kept_to(timeout: float) -> None:
    with source(camera(), patience=0.05) as stream:  # while the ladder is climbed
        begun = time.monotonic()
        with pytest.raises(FrameTimeout, match=r"455 \(USB 3\.2\): no new frame within"):
            stream.read(timeout)
        assert time.monotonic() - begun < max(2 * timeout, 0.2)


def test_a_missing_camera_is_reported_soon() -> None:
    begun = time.monotonic()
    with pytest.raises(CameraNotFound, match="No camera with the serial number 0000 is connected") as error:
        RealSenseSource(serial="0000").connect()
    assert time.monotonic() - begun < 3
    assert error.value.serial == "0000"
    with pytest.raises(CameraNotFound, match=r"found: .*D455 455 \(USB 3\.2\)"):
        source(camera(), serial="0000").connect()


def test_a_camera_in_use_is_reported() -> None:
    device = camera()
    with source(device) as stream:
        with pytest.raises(SourceError, match=r"455 \(USB 3\.2\) is in use"):
            source(device).connect()
        assert device.push_raw(*picture()) == stream.read(5).number


def test_pulled_out_and_back_in_time(caplog: pytest.LogCaptureFixture) -> None:
    device = camera()
    with source(device, patience=0.1, recover_timeout=30) as stream, streaming(device):
        stream.read(5)
        device.unplug()
        with pytest.raises(FrameTimeout, match="it is not plugged in"):
            numbers(stream, 1000, timeout=1)
        device.plug()
        assert stream.read(10, fresh=True).number
    steps = ["step 1 of 4: wait", "step 2 of 4: restart the pipeline", "delivers frames again"]
    assert [step for step in steps if step in caplog.text] == steps


def test_a_silent_camera_is_reset_and_lost(caplog: pytest.LogCaptureFixture) -> None:
    with source(camera(), patience=0.05, recover_timeout=0.8) as stream, pytest.raises(CameraLost):
        stream.read(10)
    assert "step 3 of 4: reset the camera" in caplog.text


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform != "linux", reason="counts in /proc")
def test_30_reconnects_leave_no_thread_and_no_file() -> None:
    device = camera()
    stream, before = source(device), (0, 0)
    for attempt in range(30):
        with stream:
            number = device.push_raw(*picture())
            assert stream.read(5).number == number
        if attempt == 2:  # librealsense's own are there now
            gc.collect()
            before = _open()
    deadline = time.monotonic() + 10  # a thread that was asked to end may still be ending
    while any(now > then for now, then in zip(_open(), before, strict=True)) and time.monotonic() < deadline:
        time.sleep(0.05)
    grown = [now - then for now, then in zip(_open(), before, strict=True)]
    # Less than one in ten reconnects: what other libraries of the process start meanwhile is not theirs.
    assert max(grown) < 3


def test_a_program_may_end_while_a_camera_streams() -> None:
    code = (
        "from shape_obs_envs.sources import RealSenseSource, SoftwareD455\n"
        "stream = RealSenseSource(SoftwareD455(width=160, height=120), width=160, height=120)\n"
        "stream.connect()"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def _open() -> tuple[int, int]:
    """Return the numbers of file descriptors and threads of this process."""
    return len(os.listdir("/proc/self/fd")), len(os.listdir("/proc/self/task"))


# ---- in ``ShapeObs/D455-v0`` and the wrapper


def test_a_camera_that_is_pulled_out_ends_the_episode_and_a_reset_finds_it_again():
    device, robot = camera(), FakeRobot(clock=CLOCK)
    with streaming(device):
        env = ShapeObservation(make_env(source(device), robot, timeout=0.5), **ROPE)
        env.reset()
        for _ in range(3):
            *_, truncated, info = env.step(np.zeros(2))
            assert not truncated
        device.unplug()
        truncated, info = False, {}
        for _ in range(3):  # one more may be under way
            *_, truncated, info = env.step(np.zeros(2))
            if truncated:
                break
        assert truncated
        assert "455" in info["camera_error"]
        assert robot.calls[-1] == "stop"
        assert not info["shape/ok"] or info["shape/age"] > 0
        with pytest.raises(CameraNotFound):
            env.reset()
        device.plug()
        env.reset()
        *_, truncated, info = env.step(np.zeros(2))
        assert not truncated
        env.close()
