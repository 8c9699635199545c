"""The real path: a software D455 inside librealsense, its source, ``ShapeObs/D455-v0`` and the wrapper."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from camera_scene import camera, picture, source, streaming
from fake_cell import ROPE, FakeRobot, make_env

from shape_obs import ShapeObservation
from shape_obs.source import CameraNotFound
from shape_obs.utils.timing import CLOCK
from shape_obs_envs.sources.realsense.driver import recording_suffix


def test_a_recording_gives_the_environment_the_same_images(tmp_path: Path):
    path, device, frames = tmp_path / f"rope{recording_suffix()}", camera(), []
    with source(device, record_to=path) as stream:
        for number in range(12):
            device.push_raw(*picture(number), stamp=10 + number / 30)
            frames.append(stream.read(5))
    env = make_env(str(path))
    observation, info = env.reset()
    terminated = truncated = False
    for frame in frames:
        assert np.array_equal(observation["rgb"], frame.rgb)
        assert np.array_equal(observation["depth"], frame.depth)
        assert info["frame"] == frame.number
        assert info["stamp"] == pytest.approx(frame.stamp, abs=1e-6)
        observation, _, terminated, truncated, info = env.step(0)
    assert (terminated, truncated) == (False, True)
    assert "end of the recording" in info["camera_error"]
    assert not observation["rgb"].any()
    env.reset()  # from the beginning
    assert env.unwrapped.frame.number == frames[0].number
    env.close()


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
