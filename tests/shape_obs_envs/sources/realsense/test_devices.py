"""Recordings of librealsense return the same frames; the right one of several cameras is opened."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from camera_scene import camera, picture, source

from shape_obs.source import BadRecording, CameraNotFound, EndOfSource, SeveralCameras, SourceError
from shape_obs_envs.sources import RealSenseSource, open_source
from shape_obs_envs.sources.realsense import devices
from shape_obs_envs.sources.realsense.driver import librealsense, recording_suffix
from shape_obs_envs.sources.realsense.settings import CameraOptions

rs: Any = librealsense()

FRAMES = 60
REAL = Path(__file__).parents[5] / "shared" / "data" / "real" / "realsense_d4xx_single_640x480.bag"
OTHER = {".db3": ".bag", ".bag": ".db3"}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory):
    """Return a recording, and the frames that were read while it was made."""
    path = tmp_path_factory.mktemp("recording") / f"rope{recording_suffix()}"
    device = camera()
    frames = []
    with source(device, record_to=path) as stream:
        for number in range(FRAMES):
            device.push_raw(*picture(number), stamp=10 + number / 30)
            frames.append(stream.read(5))
        intrinsics = stream.intrinsics
    return path, frames, intrinsics


def test_a_recording_gives_the_same_frames(recorded) -> None:
    path, frames, intrinsics = recorded
    stream = RealSenseSource(recording=path)
    assert (stream.kind, stream.name, stream.live) == ("recording", str(path), False)
    for read in (stream.read, stream.read_latest):  # connected again, it begins again
        with stream:
            assert stream.intrinsics == intrinsics
            assert stream.serial == "455"
            for frame in frames:
                again = read()
                assert np.array_equal(_array(again.rgb), _array(frame.rgb))
                assert np.array_equal(_array(again.depth), _array(frame.depth))
                assert (again.stamp, again.number) == (pytest.approx(frame.stamp, abs=1e-6), frame.number)
            for _ in range(2):
                with pytest.raises(EndOfSource, match=f"{path.name}: end of the recording"):
                    read()


def test_a_recording_without_depth_and_a_camera_whose_depth_is_left_out(tmp_path: Path) -> None:
    path, device = tmp_path / f"colour{recording_suffix()}", camera()
    with source(device, record_to=path, depth=False) as stream:
        assert not stream.has_depth
        for number in range(10):
            device.push_raw(*picture(number), stamp=10 + number / 30)
            assert stream.read(5).depth is None
        first = _array(stream.read_latest(9).rgb)
    options: dict[str, Any]
    for options in ({}, {"depth": False}):
        with open_source(path, **options) as again:
            assert not again.has_depth
            frames = [again.read(5) for _ in range(10)]
        assert all(frame.depth is None for frame in frames)
        assert np.array_equal(_array(frames[-1].rgb), first)
    with pytest.raises(BadRecording, match="expected a recording with depth, it has color"):
        open_source(path, depth=True).connect()


@pytest.mark.skipif(not REAL.is_file(), reason="the real recording is not available")
def test_the_recording_of_a_real_camera() -> None:
    with RealSenseSource(recording=REAL) as stream:
        frame = stream.read(10)
        intrinsics = stream.intrinsics
    assert intrinsics.size == (480, 640)
    assert not intrinsics.distorted
    assert (intrinsics.fx, intrinsics.fy) == pytest.approx((613.2, 613.4), abs=0.1)
    assert stream.name == str(REAL)
    assert frame.rgb is not None
    assert frame.depth is not None
    assert frame.rgb.std() > 20
    assert (frame.depth > 0).mean() > 0.9
    assert 300 < np.median(frame.depth[frame.depth > 0]) < 5000


def test_bad_files(recorded, tmp_path: Path) -> None:
    whole = recorded[0].read_bytes()
    suffix = recorded[0].suffix
    bad = {
        f"half{suffix}": (whole[: len(whole) // 2], "a part"),
        f"short{suffix}": (whole[:50], "a part|cannot read"),
        f"empty{suffix}": (b"", "the file is empty"),
        f"junk{suffix}": (b"hello" * 100, "got another file type"),
        f"rope{OTHER[suffix]}": (whole, f"the suffix is '{OTHER[suffix]}': rename it to rope{suffix}"),
        "rope.txt": (whole, f"rename it to rope{suffix}"),
    }
    for name, (content, message) in bad.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(BadRecording, match=message) as error:
            RealSenseSource(recording=tmp_path / name).connect()
        assert name in str(error.value)
    for path in (tmp_path / "none.db3", tmp_path):
        with pytest.raises(BadRecording, match="there is no such file"):
            RealSenseSource(recording=path).connect()


@pytest.mark.skipif(recording_suffix() != ".db3", reason="bags are written when they are closed")
def test_a_killed_recording_loses_nothing(tmp_path: Path) -> None:
    path = tmp_path / "killed.db3"
    code = (
        "import numpy as np, os, signal, time\n"
        "from shape_obs_envs.sources import RealSenseSource, SoftwareD455\n"
        "device = SoftwareD455(width=160, height=120)\n"
        f"stream = RealSenseSource(device, width=160, height=120, record_to={str(path)!r})\n"
        "stream.connect()\n"
        "for _ in range(20):\n"
        "    device.push_raw(np.zeros((120, 160, 3), np.uint8), np.full((120, 160), 700, np.uint16))\n"
        "    stream.read(5)\n"
        "time.sleep(0.5)\n"  # the recorder runs in a separate thread
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -signal.SIGKILL
    with RealSenseSource(recording=path) as stream:
        assert [stream.read(5).number for _ in range(19)] == list(range(1, 20))


def test_where_a_recording_may_go(tmp_path: Path) -> None:
    path = tmp_path / f"there{recording_suffix()}"
    path.write_bytes(b"precious")
    with pytest.raises(FileExistsError, match="exists already"):
        source(camera(), record_to=path).connect()
    assert path.read_bytes() == b"precious"
    with pytest.raises(ValueError, match=rf"writes {recording_suffix()} files"):
        source(camera(), record_to=tmp_path / "rope.mp4").connect()


def test_a_restart_goes_on_in_another_file(tmp_path: Path) -> None:
    path, device = tmp_path / f"rope{recording_suffix()}", camera()
    with source(device, record_to=path, patience=0.05, recover_timeout=30) as stream:
        for number in range(3):
            device.push_raw(*picture(), number / 30)
            stream.read(5)
        second = path.with_name(f"rope-2{path.suffix}")
        deadline = time.monotonic() + 20
        while not second.exists() and time.monotonic() < deadline:
            time.sleep(0.01)
        assert second.exists()
    with RealSenseSource(recording=path) as again:
        assert again.read(5).number == 1


def _array(image: np.ndarray | None) -> np.ndarray:
    assert image is not None
    return image


# ---- which of several cameras is opened, and a D405, whose two cameras are one

PLUGGED = [("D455", "1"), ("D435I", "2"), ("D405", "3")]


def device(model: str, serial: str) -> Any:
    """Return a device of librealsense's own, with a model's name."""
    made = rs.software_device()
    made.register_info(rs.camera_info.name, f"Intel RealSense {model}")
    made.register_info(rs.camera_info.serial_number, serial)
    return made


def found(word: str) -> str:
    """Return the serial number of the camera that a word chooses."""
    source: Any = open_source(word)
    return source._device.find().get_info(rs.camera_info.serial_number)


@pytest.fixture
def plugged(monkeypatch):
    """Let some cameras be plugged in, as librealsense would list them."""
    present: list[Any] = []
    monkeypatch.setattr(devices, "listed_cameras", lambda: present)
    return present


@pytest.mark.parametrize("word", ["d455", "D455", "d435", "d405", "d415", "d400"])
def test_every_model_opens_a_camera_that_is_alone(word, plugged):
    plugged += [device("D415", "9")]
    source = open_source(word)
    assert isinstance(source, RealSenseSource)
    assert (source.kind, source.name, source.live, source.has_depth) == (word.lower(), word.lower(), True, True)
    assert found(word) == "9"


def test_the_model_chooses_among_several(plugged):
    plugged += [device(model, serial) for model, serial in PLUGGED]
    assert [found(word) for word in ("d455", "d435", "d405")] == ["1", "2", "3"]
    assert [found(word) for word in ("d400:3", "d455:2", "d405:1")] == ["3", "2", "1"]  # the serial number decides
    for word in ("d400", "d415"):
        with pytest.raises(SeveralCameras, match=rf"D455 1, .*D405 3\): choose one by .* {word}:SERIAL"):
            found(word)
    plugged += [device("D435", "4")]
    with pytest.raises(SeveralCameras, match="d435:SERIAL"):
        found("d435")
    assert found("d435:4") == "4"
    with pytest.raises(CameraNotFound, match="serial number 7 is connected; found"):
        found("d435:7")


def test_other_models_are_refused():
    with pytest.raises(ValueError, match=r"model: expected a camera of the D400 series, .* got 'l515'"):
        RealSenseSource(model="l515")


def d405() -> Any:
    """Return a device with one sensor for both streams."""
    made = device("D405", "3")
    sensor = made.add_sensor("Stereo Module")
    for name, limits in {"enable_auto_exposure": (0, 1, 1, 1), "exposure": (1, 165_000, 1, 33_000)}.items():
        option = getattr(rs.option, name)
        sensor.add_option(option, rs.option_range(*(float(limits[at]) for at in (0, 1, 3, 2))), True)
        sensor.set_option(option, float(limits[3]))
    for stream, pixels, size in ((rs.stream.depth, rs.format.z16, 2), (rs.stream.color, rs.format.rgb8, 3)):
        video = rs.video_stream()
        video.type, video.uid, video.width, video.height, video.fps = stream, size, 640, 480, 30
        video.bpp, video.fmt = size, pixels
        sensor.add_video_stream(video)
    return made, sensor


def test_the_exposure_of_a_d405_is_set_in_the_unit_of_its_depth_camera():
    made, sensor = d405()
    CameraOptions(exposure=0.01).apply(made)
    assert sensor.get_option(rs.option.exposure) == 10_000  # microseconds
    assert sensor.get_option(rs.option.enable_auto_exposure) == 0
    with pytest.raises(SourceError, match=r"exposure 0\.5 s: expected 1e-06 to 0\.165"):
        CameraOptions(exposure=0.5).apply(made)
    with pytest.raises(SourceError, match=r"laser_power .*: the camera has no such option"):
        CameraOptions(laser_power=150).apply(made)
