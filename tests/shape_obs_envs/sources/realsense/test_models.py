"""Cameras of the D400 series other than a D455: which of several is opened, and a D405, whose two cameras are one."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip("pyrealsense2")

import pyrealsense2

from shape_obs.source import CameraNotFound, SeveralCameras, SourceError
from shape_obs_envs.sources import RealSenseSource, open_source
from shape_obs_envs.sources.realsense import devices
from shape_obs_envs.sources.realsense.settings import CameraOptions

rs: Any = pyrealsense2
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
