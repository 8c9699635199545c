"""The real path: a software D455 inside librealsense, its source, ``ShapeObs/D455-v0`` and the wrapper."""

from __future__ import annotations

import numpy as np
import pytest
from camera_scene import camera, source, streaming
from fake_cell import ROPE, FakeRobot, make_env

from shape_obs import ShapeObservation
from shape_obs.source import CameraNotFound
from shape_obs.utils.timing import CLOCK


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
