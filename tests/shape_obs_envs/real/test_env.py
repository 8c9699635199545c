"""``ShapeObs/D455-v0``: steps, deadlines, failures and the limits on actions."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from fake_camera import INTRINSICS
from fake_cell import PATIENT, ROPE, FakeRobot, cell, make_env, rope, rope_camera
from fake_clock import FakeClock
from gymnasium.utils.env_checker import check_env
from hypothesis import given
from hypothesis import strategies as st
from mjpeg_camera import MjpegCamera

from shape_obs import ShapeObservation
from shape_obs.deploy import Still, deploy
from shape_obs.robot import ActionSpec, Robot
from shape_obs.servo.action_limiter import Guard
from shape_obs.source import BadRecording, CameraNotFound, NotConnected, RGBDSource
from shape_obs.utils.timing import Rate


@pytest.mark.parametrize("robot", [None, FakeRobot(3)])
def test_both_checkers_pass_bare_and_wrapped(robot):
    from stable_baselines3.common.env_checker import check_env as check_sb3

    env = make_env(robot=robot)
    check_env(env.unwrapped, skip_render_check=True)
    check_sb3(env.unwrapped)
    check_sb3(ShapeObservation(env, **ROPE))
    assert isinstance(env.unwrapped.source, RGBDSource)
    assert robot is None or isinstance(robot, Robot)


def test_a_step_shows_what_was_done_and_never_an_older_image():
    env = make_env(robot=FakeRobot())
    env.reset()
    number, observation = -1, {}
    for _ in range(5):
        observation, reward, terminated, truncated, info = env.step(np.array([1.0, 0.0]))
        assert (reward, terminated, truncated) == (0.0, False, False)
        assert info["frame"] > number
        number = info["frame"]
        assert env.unwrapped.frame.received >= env.unwrapped.sent_at
    assert observation["robot"] == pytest.approx([0.05, 0.0])
    blue = np.flatnonzero((observation["rgb"][..., 0] < 100).any(axis=0))
    assert blue.min() == pytest.approx(40 - 3 + 100 * 0.05 / 0.7, abs=2)


def test_steps_keep_the_rate_for_any_duration_of_the_policy_and_report_overruns():
    env = make_env(robot=FakeRobot(), rate=25.0)
    env.reset()
    clock = env.unwrapped.clock
    begin = clock.now()
    for i in range(10):
        clock.sleep(0.02 if i % 2 else 0.0)
        *_, info = env.step(None)
        assert not info["overrun"]
    assert clock.now() - begin == pytest.approx(0.4)
    clock.sleep(0.1)
    *_, info = env.step(None)
    assert info["overrun"]
    assert env.unwrapped.rate.overruns == 1


def test_a_late_loop_does_not_hurry_to_catch_up():
    clock = FakeClock()
    rate = Rate(100, clock)
    clock.sleep(0.055)
    assert rate.wait() == pytest.approx(-0.045)
    begin = clock.now()
    assert rate.wait() == rate.wait() == pytest.approx(0.01)
    assert clock.now() - begin == pytest.approx(0.02)
    assert rate.overruns == 1


@pytest.mark.parametrize("delay", [0.0, 0.08])
def test_with_settle_a_frame_shows_what_was_there_after_the_motion(delay):
    env, _, camera = cell(settle=0.03)
    env.reset()
    camera.delay = delay  # from now on all images are older than they were at the reset
    for _ in range(4):
        *_, info = env.step(np.array([0.5, 0.0]))
        assert info["received"] - info["lag"] >= env.unwrapped.sent_at + 0.02 + 0.03
        assert not info["overrun"]
    report = deploy(cell(settle=0.02)[0], Still(), PATIENT, steps=3)
    assert (report.acted, report.overruns) == (3, 0)
    assert report.seconds > 3 * (0.02 + 0.02)
    camera.delay = 5.0  # images that stay late are taken when the time is over
    *_, truncated, info = env.step(np.zeros(2))
    assert not truncated
    assert info["lag"] == pytest.approx(5.0)
    with pytest.raises(ValueError, match="settle: expected seconds from 0 to below 10, or None, got -1"):
        cell(settle=-1)


def test_none_stands_still():
    robot = FakeRobot()
    env = make_env(robot=robot)
    env.reset()
    env.step(None)
    assert robot.calls[-1] == "stop"
    assert "send" not in robot.calls


@pytest.mark.parametrize(("fault", "error"), [("stall", "no frame in"), ("unplug", "it was unplugged")])
def test_a_failing_camera_ends_the_episode_in_black_and_the_next_reset_reconnects(fault, error):
    env, robot, camera = cell()
    env.reset()
    getattr(camera, fault)()
    _, _, terminated, truncated, info = env.step(np.zeros(2))
    assert (terminated, truncated) == (False, True)
    assert error in info["camera_error"]
    assert robot.calls[-1] == "stop"
    assert info["shape/age"] > 0
    with pytest.raises(NotConnected):
        env.step(np.zeros(2))
    if fault == "unplug":
        with pytest.raises(CameraNotFound):
            env.reset()
    camera.plug()
    _, info = env.reset()
    assert info["shape/ok"]
    assert info["shape/age"] == 0
    bare = env.unwrapped
    camera.stall()
    observation, *_ = bare.step(np.zeros(2))
    assert not observation["rgb"].any()
    assert not observation["depth"].any()
    assert bare.observation_space.contains(observation)


def test_a_failing_robot_ends_the_episode():
    robot = FakeRobot()
    env = make_env(robot=robot)
    env.reset()
    robot.broken.add("send")
    *_, truncated, info = env.step(np.zeros(2))
    assert truncated
    assert info["robot_error"] == "send: the robot is in an emergency stop"


def test_the_camera_model_is_nominal_before_and_the_cameras_own_after_the_reset():
    env = make_env()
    assert env.get_wrapper_attr("camera_model").intrinsics.fx == pytest.approx(386 / 4)
    assert env.get_wrapper_attr("camera_model").transform_camera_to_base[2, 3] == 0.7
    env.reset()
    assert env.get_wrapper_attr("camera_model").intrinsics == INTRINSICS


def test_robots_and_sources_by_name():
    env = make_env(rope_camera(), "fake_cell:FakeRobot", robot_arguments={"size": 3})
    assert env.action_space.shape == (3,)
    with pytest.raises(ImportError, match="robot: cannot import 'no_lab'"):
        make_env(rope_camera(), "no_lab:Arm")
    with pytest.raises(ValueError, match="did you mean 'FakeRobot'"):
        make_env(rope_camera(), "fake_cell:FakeRobt")
    with pytest.raises(ValueError, match="has no camera"):
        make_env("robot", FakeRobot())


# ---- webcams, videos and photos: features in pixels, no depth


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


# ---- limits on actions

SPEC = ActionSpec(("x", "yaw"), ("m", "rad"), (0.02, 0.1), (-0.3, -1.0), (0.3, 1.0))
numbers = st.floats(-5, 5)


@given(st.tuples(numbers, numbers), st.tuples(st.floats(-0.4, 0.4), st.floats(-1.5, 1.5)))
def test_no_guarded_motion_is_too_long_or_leads_out(action, state):
    guard = Guard(SPEC, max_step=[0.01, 0.2], workspace=((-0.2, -9), (0.25, 9)))
    motion = guard.motion(action, state).motion
    assert np.all(np.abs(motion) <= np.array([0.01, 0.1]) + 1e-12)
    target = np.asarray(state) + motion
    outside = np.maximum(guard.low - target, 0) + np.maximum(target - guard.high, 0)
    before = np.maximum(guard.low - state, 0) + np.maximum(np.asarray(state) - guard.high, 0)
    assert np.all(outside <= before + 1e-12)


def test_the_guard_reports_what_it_did():
    guard = Guard(SPEC)
    assert guard.motion([0.5, -0.5], [0, 0])[1:] == (False, False, False)
    assert guard.motion([2.0, 0.0], [0, 0])[1:] == (True, False, False)
    assert Guard(SPEC, max_step=[0.01, 1]).motion([1.0, 0.0], [0, 0])[1:] == (False, True, False)
    assert guard.motion([1.0, 0.0], [0.295, 0]).boxed


@pytest.mark.parametrize("mode", ["displacement", "velocity", "position"])
def test_the_guard_speaks_each_mode(mode):
    spec = ActionSpec(("x",), ("m",), (0.01,), (-1,), (1,), mode)
    assert Guard(spec, max_step=[0.5], dt=0.1).motion([1.0], [0.0]).motion == pytest.approx([0.01])
    if mode != "position":
        assert Guard(spec, dt=0.1).max_step == pytest.approx([0.001 if mode == "velocity" else 0.01])
    capped = Guard(spec, max_step=[0.0005], dt=0.1).motion([1.0], [0.0])
    assert capped.capped
    assert capped.motion == pytest.approx([0.005 if mode == "velocity" else 0.0005])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"max_step": [1.0]}, "max_step: expected 2 numbers"),
        ({"max_step": [0.0, 1.0]}, "max_step: expected positive"),
        (
            {"workspace": [[0.4, -1], [0.5, 1]]},
            "nothing is left of 'x', which the robot can move within -0.3",
        ),
    ],
)
def test_bad_guards_raise_an_error(options, message):
    with pytest.raises(ValueError, match=message):
        Guard(SPEC, **options)
    with pytest.raises(ValueError, match="action: expected 2 finite numbers"):
        Guard(SPEC).motion([np.nan, 0], [0, 0])


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"units": ["m"]}, "ActionSpec.units: expected 2 values"),
        ({"units": ["m", "deg"]}, "expected 'm', 'rad', '1', got 'deg'"),
        ({"low": [1, -1], "high": [0, 1]}, "finite low < high"),
        ({"names": ["x", "x"]}, "different names"),
        ({"scale": [0, 1]}, "positive"),
    ],
)
def test_bad_action_specs_raise_an_error(fields, message):
    with pytest.raises(ValueError, match=message):
        ActionSpec.from_dict({**SPEC.to_dict(), **fields})
