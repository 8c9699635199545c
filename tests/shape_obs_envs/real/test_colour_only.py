"""Webcams, videos and photos in the live environment and in the deployment loop: features in pixels, no depth."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from fake_cell import ROPE, make_env, rope, rope_camera
from gymnasium.utils.env_checker import check_env
from mjpeg_camera import MjpegCamera

from shape_obs import ShapeObservation
from shape_obs.source import BadRecording


def draw(number: int):
    """Return a blue rope on gray, 1 pixel lower in every image."""
    return rope(down=number % 30 - 10)


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    """Return a video and a folder of photos, of twelve frames each."""
    folder = tmp_path_factory.mktemp("photos")
    video = folder.parent / "rope.avi"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (160, 120))
    for number in range(12):
        image = np.ascontiguousarray(draw(number)[..., ::-1])
        writer.write(image)
        cv2.imwrite(str(folder / f"{number}.png"), image)
    writer.release()
    return {"video": str(video), "photos": str(folder)}


@pytest.mark.parametrize("kind", ["video", "photos", "webcam"])
def test_the_observation_has_no_depth_and_features_in_pixels_are_exact(kind, sources):
    with MjpegCamera(draw, 30.0) as camera:
        env = make_env({**sources, "webcam": f"webcam:{camera.url}"}[kind], timeout=1.0)
        assert set(env.observation_space.spaces) == {"rgb"}
        assert env.get_wrapper_attr("camera_model") is None
        wrapped = ShapeObservation(env, **ROPE, features=["points2d_normalized"])
        assert wrapped.observation_space.shape == (20,)
        observation, info = wrapped.reset()
        for _ in range(4):
            observation, *_, info = wrapped.step(0)
            assert info["shape/ok"]
            frame = env.unwrapped.frame
            dark = np.flatnonzero((frame.rgb[:, 75, 0] < 110) & (frame.rgb[:, 75, 2] > 150))
            assert wrapped.detection is not None
            points = wrapped.detection.shapes[0].points2d
            assert points is not None
            assert abs(points[:, 1].mean() - dark.mean()) < 1.5
            assert abs(abs(points[-1, 0] - points[0, 0]) - 74) < 6
            assert wrapped.detection.shapes[0].points3d is None
        assert wrapped.observation_space.contains(observation)
        if kind == "webcam":
            assert env.unwrapped.frame.received >= env.unwrapped.sent_at
            assert 0 < env.unwrapped.seen_at - info["exposed"] < 1
        wrapped.close()


@pytest.mark.parametrize(
    ("config", "missing"),
    [
        ({"features": ["points3d"]}, "feature 'points3d'"),
        ({"shapes": [{"kind": "centerline", "spacing": "m"}]}, "spacing='m' of shape 'centerline'"),
        ({"segmentation": {"kind": "depth", "near": 0.3, "far": 0.9}}, "segmentation 'depth'"),
    ],
)
def test_what_needs_depth_is_refused_when_the_env_is_made(config, missing, sources):
    with pytest.raises(ValueError, match=f"no 'depth', but the config needs it: {missing}"):
        ShapeObservation(make_env(sources["video"]), **{**ROPE, **config})


def test_depth_can_be_required_or_left_out(sources, tmp_path):
    with pytest.raises(ValueError, match=r"depth: .*rope\.avi has none"):
        make_env(sources["video"], depth=True)
    env = make_env(depth=False)
    assert set(env.reset()[0]) == set(env.observation_space.spaces) == {"rgb"}
    check_env(env.unwrapped, skip_render_check=True)
    assert set(make_env(depth=True).observation_space.spaces) == {"rgb", "depth"}
    unknown = rope_camera(intrinsics=None)
    with pytest.raises(ValueError, match=r"has depth but no intrinsics.*depth=False"):
        make_env(unknown).reset()
    make_env(unknown, depth=False).reset()
    with pytest.raises(BadRecording, match="found neither"):
        make_env(str(tmp_path))


def test_the_end_of_a_video_ends_the_episode(sources):
    env = make_env(sources["video"])
    env.reset()
    infos = [env.step(0)[4] for _ in range(11)]
    assert not any("camera_error" in info for info in infos)
    *_, truncated, info = env.step(0)
    assert truncated
    assert "end of its 12 frames" in info["camera_error"]
    env.close()


def test_a_robot_is_deployed_with_a_webcam(run, tmp_path):
    config = "version: 1\nshape: {{shapes: [{{kind: centerline, n: 10, ends: tips}}], features: [{}]}}\n"
    config += "scene: {{segmentation: {{kind: hsv, low: [100, 120, 40], high: [125, 255, 255]}}}}\n"
    for name in ("points2d_normalized", "points3d"):
        (tmp_path / f"{name}.yaml").write_text(config.format(name))
    pixels = "--config", tmp_path / "points2d_normalized.yaml"
    with MjpegCamera(draw, 30.0) as camera:
        start = ["deploy", "--source", f"webcam:{camera.url}", "--robot", "shape_obs_envs.robots:NullRobot"]
        sized = [*start, "--size", "160", "120", "--seconds", "1", "--max-age", "1", "--json"]
        code, out, err = run(*sized, *pixels, "--log", tmp_path / "run")
        assert code == 0, err
        report = json.loads(out)
        assert report["steps"] > 10
        assert report["acted"] > 0.8 * report["steps"]
        code, _, err = run(*sized, "--config", tmp_path / "points3d.yaml")
        assert code == 1
        assert "no 'depth', but the config needs it: feature 'points3d'" in err
        code, _, err = run(*start, *pixels, "--seconds", "1")
        assert code == 1
        assert "provides images of 160 x 120 pixels, the env expects 640 x 480: make it with size=[160, 120]" in err
