"""Webcams, videos and photos in the live environment and in the deployment loop: features in pixels, no depth."""

from __future__ import annotations

import json
import time
from typing import Any

import cv2
import gymnasium as gym
import numpy as np
import pytest
from cell_parts import HEIGHT, ROPE, WIDTH, ListRobot, RopeSource
from gymnasium.utils.env_checker import check_env
from mjpeg_camera import MjpegCamera

from shape_obs import ShapeObservation
from shape_obs.cli import main
from shape_obs.source import BadRecording, EndOfSource


def draw(number: int):
    """Return a blue rope on gray, 1 pixel lower in every image."""
    rgb = np.full((HEIGHT, WIDTH, 3), 200, np.uint8)
    cv2.line(rgb, (40, 50 + number % 30), (120, 56 + number % 30), (20, 60, 200), 5)
    return rgb


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    path = tmp_path_factory.mktemp("video") / "rope.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (WIDTH, HEIGHT))
    for number in range(12):
        writer.write(np.ascontiguousarray(draw(number)[..., ::-1]))
    writer.release()
    return path


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    folder = tmp_path_factory.mktemp("photos")
    for number in range(12):
        cv2.imwrite(str(folder / f"{number}.png"), draw(number)[..., ::-1])
    return folder


def make(source: Any, **options) -> Any:
    given = {"rate": 50.0, "size": [WIDTH, HEIGHT], "timeout": 1.0, "disable_env_checker": True, **options}
    return gym.make("shape_obs_envs:ShapeObs/D455-v0", source=source, **given)


@pytest.mark.parametrize("kind", ["video", "photos", "webcam"])
def test_the_observation_has_no_depth_and_features_in_pixels_are_exact(kind, video, photos):
    with MjpegCamera(draw, 30.0) as camera:
        source = {"video": str(video), "photos": str(photos), "webcam": f"webcam:{camera.url}"}[kind]
        env = make(source)
        assert set(env.observation_space.spaces) == {"rgb"}
        assert env.get_wrapper_attr("camera_model") is None
        wrapped = ShapeObservation(env, **ROPE, features=["points2d_normalized"])
        assert wrapped.observation_space.shape == (20,)
        observation, info = wrapped.reset()
        for _ in range(4):
            observation, *_, info = wrapped.step(0)
            assert info["shape/ok"]
            frame = env.unwrapped.frame
            dark = np.flatnonzero((frame.rgb[:, 80, 0] < 110) & (frame.rgb[:, 80, 2] > 150))
            assert wrapped.detection is not None
            points = wrapped.detection.shapes[0].points2d
            assert points is not None
            assert abs(points[:, 1].mean() - dark.mean()) < 1.5
            assert abs(abs(points[-1, 0] - points[0, 0]) - 84) < 6
            assert wrapped.detection.shapes[0].points3d is None
        assert wrapped.observation_space.contains(observation)
        if kind == "webcam":
            assert env.unwrapped.frame.received >= env.unwrapped.sent_at
            assert time.monotonic() - info["exposed"] < 1
        wrapped.close()


def test_the_checker_passes():
    env = make(RopeSource(), depth=False)
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


@pytest.mark.parametrize(
    ("config", "missing"),
    [
        ({"features": ["points3d"]}, "feature 'points3d'"),
        ({"shapes": [{"kind": "centerline", "spacing": "m"}]}, "spacing='m' of shape 'centerline'"),
        ({"segmentation": {"kind": "depth", "near": 0.3, "far": 0.9}}, "segmentation 'depth'"),
    ],
)
def test_what_needs_depth_is_refused_when_the_env_is_made(config, missing, video):
    given = {**ROPE, **config}
    if "segmentation" in config:
        given["segmentation"] = config["segmentation"]
    with pytest.raises(ValueError, match=f"no 'depth', but the config needs it: {missing}"):
        ShapeObservation(make(str(video)), **given)


def test_depth_can_be_required_or_left_out(video):
    with pytest.raises(ValueError, match=r"depth: .*rope\.avi has none"):
        make(str(video), depth=True)
    env = make(RopeSource(), depth=False)
    assert set(env.observation_space.spaces) == {"rgb"}
    observation, _ = env.reset()
    assert set(observation) == {"rgb"}
    env.close()
    assert set(make(RopeSource(), depth=True).observation_space.spaces) == {"rgb", "depth"}


def test_depth_without_intrinsics_is_refused_at_the_reset():
    class Unknown(RopeSource):
        @property
        def camera(self):  # pyright: ignore[reportIncompatibleVariableOverride]
            return None

    env = make(Unknown())
    with pytest.raises(ValueError, match=r"has depth but no intrinsics.*depth=False"):
        env.reset()
    env = make(Unknown(), depth=False)
    env.reset()
    env.close()


def test_a_recording_that_cannot_be_read_is_an_error_when_the_env_is_made(tmp_path):
    with pytest.raises(BadRecording, match="found neither"):
        make(str(tmp_path))


def test_a_webcam_that_disappears_ends_the_episode_and_the_next_reset_connects_again():
    robot = ListRobot()
    camera = MjpegCamera(draw, 30.0)
    env = make(f"webcam:{camera.url}", robot=robot, timeout=0.5)
    env.reset()
    env.step(np.zeros(2))
    camera.close()
    observation, truncated, info = {}, False, {}
    for _ in range(60):
        observation, _, _, truncated, info = env.step(np.zeros(2))
        if truncated:
            break
    assert truncated
    assert "no new frame" in info["camera_error"] or "was unplugged" in info["camera_error"]
    assert not observation["rgb"].any()
    assert robot.calls[-1] == "stop"
    with MjpegCamera(draw, 30.0, camera.port):
        observation, _ = env.reset()
        assert observation["rgb"].any()
    env.close()


def test_the_end_of_a_video_ends_the_episode(video):
    env = make(str(video))
    env.reset()
    infos = [env.step(0)[4] for _ in range(11)]
    assert not any("camera_error" in info for info in infos)
    *_, truncated, info = env.step(0)
    assert truncated
    assert "end of its 12 frames" in info["camera_error"]
    env.close()
    assert issubclass(EndOfSource, OSError)


# ---- shape-obs deploy


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as stop:
        main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return stop.value.code, captured.out, captured.err


def test_a_robot_is_deployed_with_a_webcam(capsys, tmp_path):
    config = "version: 1\nshape: {{shapes: [{{kind: centerline, n: 10, ends: tips}}], features: [{}]}}\n"
    config += "scene: {{segmentation: {{kind: hsv, low: [100, 120, 40], high: [125, 255, 255]}}}}\n"
    for name in ("points2d_normalized", "points3d"):
        (tmp_path / f"{name}.yaml").write_text(config.format(name))
    with MjpegCamera(draw, 30.0) as camera:
        cell = ["deploy", "--source", f"webcam:{camera.url}", "--robot", "shape_obs_envs.robots:NullRobot"]
        cell += ["--size", WIDTH, HEIGHT, "--seconds", "2", "--json"]
        code, out, err = run(
            capsys, *cell, "--config", tmp_path / "points2d_normalized.yaml", "--log", tmp_path / "run"
        )
        assert code == 0, err
        report = json.loads(out)
        assert report["steps"] > 30
        assert report["acted"] > 0.8 * report["steps"]
        code, _, err = run(capsys, *cell, "--config", tmp_path / "points3d.yaml")
        assert code == 1
        assert "no 'depth', but the config needs it: feature 'points3d'" in err
        code, _, err = run(capsys, *cell[:5], "--config", tmp_path / "points2d_normalized.yaml", "--seconds", "1")
        assert code == 1
        assert "provides images of 160 x 120 pixels, the env expects 640 x 480: make it with size=[160, 120]" in err
