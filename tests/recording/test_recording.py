"""Recordings: nothing that was written is lost, and what is damaged is named."""

from __future__ import annotations

import json
import resource
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import cv2
import gymnasium as gym
import numpy as np
import pytest
from noise_frames import camera_of, equal, noise
from rope_env import RopeEnv

import shape_obs
from shape_obs import CameraModel, Intrinsics, ShapeDetector
from shape_obs.recording import Moment, Recording, RecordingWriter, ShapeLog, Transition, record, replay, writer
from shape_obs.recording.format import read_moments
from shape_obs.source import BadRecording, SourceError
from shape_obs_envs.sources import EnvSource, FolderSource

FRAMES = 20


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Return some frames."""
    folder = tmp_path_factory.mktemp("noise") / "recording"
    summary = record(camera_of(noise(FRAMES), live=False), folder, frames=FRAMES)
    assert (summary.frames, summary.missed, summary.dropped, summary.stopped) == (FRAMES, 0, 0, "done")
    return folder


def test_float_depth_cameras_that_move_and_missing_colour_come_back_too(tmp_path):
    model = Intrinsics(32, 24, 40.1, 40.2, 15.5, 11.5)
    draw = np.random.default_rng(1)
    frames = []
    for i in range(4):
        pose = np.eye(4)
        pose[:3, 3] = draw.normal(size=3)
        depth = draw.normal(size=(24, 32)).astype(np.float32 if i % 2 else np.float64)
        depth[3] = np.nan
        frames.append(shape_obs.Frame(None, depth, CameraModel(model, pose), stamp=draw.normal(), number=i))
    record(camera_of(frames, live=False), tmp_path / "r", frames=4)
    back = Recording(tmp_path / "r")
    for i, frame in enumerate(frames):
        got = back[i].frame
        assert got.rgb is None
        assert got.camera is not None
        assert equal(got.depth, frame.depth)
        assert got.stamp == frame.stamp
        assert equal(got.camera.transform_camera_to_base, frame.camera.transform_camera_to_base)


# ---- interruptions


def test_a_recording_cut_at_any_byte_keeps_every_whole_frame(recorded, tmp_path):
    folder = tmp_path / "cut"
    shutil.copytree(recorded, folder)
    text = (folder / "frames.jsonl").read_bytes()
    lines = text.splitlines(keepends=True)
    ends = np.cumsum([len(line) for line in lines])
    draw = np.random.default_rng(0)
    cuts = {
        *draw.integers(ends[0], len(text), 12).tolist(),
        *(int(end) + step for end in ends[-3:-1] for step in (-1, 0, 1)),
    }
    for cut in sorted(cuts):
        (folder / "frames.jsonl").write_bytes(text[:cut])
        recording = Recording(folder)
        # A line that lacks nothing but its end is whole.
        whole = sum(end - 1 <= cut for end in ends[:-1].tolist())
        assert len(recording) == whole, cut
        assert "was interrupted" in recording.warning
        assert equal(
            recording[-1].frame.rgb, np.asarray(cv2.imread(str(folder / f"rgb/{whole - 1:06d}.png")))[..., ::-1]
        )
    (folder / "frames.jsonl").write_bytes(text[: ends[9] + 20])
    for name in ("rgb/000009.png", "depth/000008.png"):  # as after a power cut
        (folder / name).write_bytes((folder / name).read_bytes()[:-30])
    with (
        pytest.warns(UserWarning, match="its 8 whole frames are read, the last 3 left out"),
        FolderSource(folder) as source,
    ):
        assert len(source) == 8
    (folder / "frames.jsonl").write_bytes(text[:40])
    with pytest.raises(BadRecording, match="the recording holds no whole frame"):
        Recording(folder)


KILLED = """
import sys
from noise_frames import camera_of, noise
from shape_obs.recording import record
record(camera_of(noise(4) * 1000, live=False), sys.argv[1], on_frame=lambda _: print("frame", flush=True))
"""


def test_a_killed_recording_loses_nothing_that_was_written(tmp_path):
    folder = tmp_path / "killed"
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(folder)],
        cwd=Path(__file__).parents[1] / "support",
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    for _ in range(100):
        assert process.stdout.readline() == "frame\n"
    process.kill()
    process.communicate()
    lines = (folder / "frames.jsonl").read_bytes().count(b"\n")
    recording = Recording(folder)
    assert "was interrupted" in recording.warning
    assert lines <= len(recording) <= lines + 1
    assert lines > 100 - 64 - 3, "no more than what waited for the encoders is missing"
    assert not any(recording.check())


# ---- lost cameras, slow encoders and full disks


@pytest.mark.parametrize(
    ("error", "stopped"),
    [(KeyboardInterrupt(), "interrupted"), (SourceError("the cable was pulled"), "the cable was pulled")],
)
def test_a_recording_that_is_interrupted_or_whose_camera_is_lost_keeps_what_came(error, stopped, tmp_path):
    recorded = record(camera_of(noise(5), error), tmp_path / "r")
    assert (recorded.frames, recorded.stopped) == (5, stopped)
    recording = Recording(tmp_path / "r")
    assert (len(recording), recording.ended["stopped"], recording.warning) == (5, stopped, "")


def test_nothing_is_left_where_nothing_came(tmp_path):
    lost = camera_of(noise(1), SourceError("no camera"))
    with lost:
        lost.read()
    with pytest.raises(SourceError, match="no camera"):
        record(lost, tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_frames_that_were_missed_and_dropped_are_reported(tmp_path, monkeypatch):
    gaps = camera_of(noise(5, numbers=[7, 8, 11, 12, 14]), KeyboardInterrupt())
    assert record(gaps, tmp_path / "gaps").missed == 3
    gate, store = threading.Event(), writer.store
    monkeypatch.setattr(writer, "store", lambda *given: gate.wait(60) and store(*given))
    with RecordingWriter(tmp_path / "slow", camera_of(noise(1)), workers=1, pending=2) as slow:
        taken = [slow.add(Moment(frame), wait=False) for frame in noise(5)]
        gate.set()
    assert taken == [True, True, False, False, False]
    assert slow.frames == len(Recording(tmp_path / "slow")) == 2


def test_a_full_disk_is_reported_and_what_is_written_is_kept(tmp_path):
    """A limit on the size of files acts as a full disk: the line of some frame no longer fits."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    try:
        with pytest.raises(OSError, match=r"cannot write .*frames\.jsonl: .*; \d+ whole frames are kept in"):
            record(camera_of(noise(400, size=(4, 4)), live=False), tmp_path / "r", frames=400)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    recording = Recording(tmp_path / "r")
    assert 20 < len(recording) < 400
    assert not any(recording.check())
    with pytest.raises(FileExistsError, match="the folder is not empty"):
        record(camera_of(noise(1)), tmp_path / "r")


# ---- damage


@pytest.mark.parametrize(
    ("name", "damage", "message"),
    [
        ("rgb/000003.png", "flip", r"rgb/000003\.png: damaged, its checksum differs"),
        ("depth/000003.png", "cut", r"depth/000003\.png: damaged, its checksum differs"),
        ("depth/000003.png", "remove", r"depth/000003\.png: cannot be read \(No such file or directory\)"),
        ("camera.json", "remove", r"camera\.json: missing"),
        ("camera.json", "cut", r"camera\.json: cannot be read"),
        ("camera.json", "list", r"camera\.json: expected a file with format 'shape_obs recording'"),
        ("camera.json", "newer", r"camera\.json: expected version \d, got 9: update shape-obs"),
        ("frames.jsonl", "number", r"frames\.jsonl, line 4: damaged"),
        ("frames.jsonl", "remove", r"frames\.jsonl: cannot be read"),
        ("frames.jsonl", "line", r"frames\.jsonl, line 4: damaged"),
        ("frames.jsonl", "fewer", r"frames\.jsonl: 19 frames, but its last line counts 20"),
    ],
)
def test_damaged_files_are_named(recorded, tmp_path, name, damage, message):
    folder = tmp_path / "damaged"
    shutil.copytree(recorded, folder)
    path = folder / name
    data, half = path.read_bytes(), path.stat().st_size // 2
    before, after = data.split(b"\n")[:3], data.split(b"\n")[4:]
    damaged = {
        "cut": data[:half],
        "flip": data[:half] + bytes([data[half] ^ 255]) + data[half + 1 :],
        "line": b"\n".join([*before, b"{oops", *after]),
        "number": b"\n".join([*before, b"4", *after]),
        "fewer": b"\n".join([*before, *after]),
        "list": b"[]",
        "newer": b'{"format": "shape_obs recording", "version": 9}',
    }
    path.unlink()
    if damage != "remove":
        path.write_bytes(damaged[damage])
    with pytest.raises(BadRecording, match=message), FolderSource(folder) as source:
        list(read_moments(source, 4))


def test_checking_reports_all_damage(recorded, tmp_path):
    folder = tmp_path / "damaged"
    shutil.copytree(recorded, folder)
    for name in ("rgb/000003.png", "depth/000007.png"):
        (folder / name).write_bytes(b"junk")
    wrong = [text for text in Recording(folder).check() if text]
    assert len(wrong) == 2
    assert "rgb/000003.png" in wrong[0]
    assert "depth/000007.png" in wrong[1]


# ---- environments and robots: actions, rewards, ends of episodes and states

BLUE = {"kind": "hsv", "low": [100, 120, 60], "high": [125, 255, 255]}


class PayingRope(RopeEnv):
    """A rope environment whose rewards count the steps, and that is terminated after the third step."""

    def step(self, action):
        observation, _, _, _, info = super().step(action)
        return observation, float(self.steps), self.steps == 3, False, info


def policy(observation):
    return np.array([observation["hand"][0]], np.float32)


@pytest.fixture(scope="module")
def stepped(tmp_path_factory):
    """Return a recording of nine frames, in three episodes, and what the environment did."""
    folder, done = tmp_path_factory.mktemp("steps") / "recording", []

    class Noted(gym.Wrapper):
        def reset(self, **given):
            found = self.env.reset(**given)
            done.append((found[0], None, None, False))
            return found

        def step(self, action):
            found = self.env.step(action)
            done.append((found[0], action, *found[1:3]))
            return found

    with EnvSource(Noted(PayingRope()), actions=policy, seed=3) as source:
        summary = record(source, folder, frames=9)
    assert (summary.frames, summary.actions) == (9, 6)
    return folder, done


def table_of(folder):
    detector = ShapeDetector(["centerline"], BLUE)
    with FolderSource(folder) as source:
        log = ShapeLog(detector, source=source)
        for moment, detection in replay(source, detector):
            log.add(moment, detection)
    return log.table()


def test_a_recording_has_what_the_environment_returned(stepped):
    folder, done = stepped
    recording = Recording(folder)
    assert recording.robot is not None
    assert recording.robot.action == ("action",)
    assert recording.robot.state == ("hand/0", "hand/1", "hand/2"), "vectors, not images, numbers or nested entries"
    for i, (observation, action, reward, terminated) in enumerate(done):
        moment = recording[i]
        assert moment.state == tuple(map(float, observation["hand"]))
        assert moment.transition == Transition(
            i % 4 if i < 8 else 0, None if action is None else tuple(action), reward, terminated
        )
    assert recording.episodes == [0, 0, 0, 0, 1, 1, 1, 1, 2]


def test_a_row_of_a_table_holds_the_action_chosen_for_its_frame(stepped):
    folder, done = stepped
    table = table_of(folder)
    for i, (observation, *_) in enumerate(done):
        assert np.array_equal(table["state"][i], observation["hand"])
        if i in (3, 7, 8):  # no step followed
            assert np.isnan(table["action"][i]).all()
            assert np.isnan(table["reward"][i])
            assert not table["terminated"][i]
        else:
            assert table["action"][i] == policy(observation)
            assert table["reward"][i] == i % 4 + 1
            assert table["terminated"][i] == (i % 4 == 2)
    assert not table["truncated"].any()
    assert table["step"].tolist() == [0, 1, 2, 3, 0, 1, 2, 3, 0]
    assert table.metadata["robot"]["state"] == ["hand/0", "hand/1", "hand/2"]


def test_a_recording_of_a_recording_keeps_all(stepped, tmp_path):
    with FolderSource(stepped[0]) as source:
        record(source, tmp_path / "again")
    first, again = Recording(stepped[0]), Recording(tmp_path / "again")
    assert again.robot == first.robot
    for i in range(9):
        assert (again[i].transition, again[i].state) == (first[i].transition, first[i].state)


def test_recordings_of_earlier_versions_have_no_steps(stepped, tmp_path):
    """They lack the entries in both files, and open as before."""
    with FolderSource(stepped[0]) as source:
        record(source, tmp_path / "old")
    camera = json.loads((tmp_path / "old" / "camera.json").read_text())
    del camera["robot"]
    (tmp_path / "old" / "camera.json").write_text(json.dumps(camera))
    lines = [json.loads(line) for line in (tmp_path / "old" / "frames.jsonl").read_text().splitlines()]
    for line in lines:
        for name in ("transition", "state"):
            line.pop(name, None)
    (tmp_path / "old" / "frames.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    old = Recording(tmp_path / "old")
    assert (old.robot, old[2].transition, old[2].state) == (None, None, None)
    table = table_of(tmp_path / "old")
    assert "action" not in table.columns
    assert np.array_equal(table["centerline/points2d"], table_of(stepped[0])["centerline/points2d"])
    with pytest.raises(KeyError, match="Only recordings of a robot or an environment have it"):
        table["action"]


@pytest.mark.parametrize(
    ("space", "action", "values", "names"),
    [
        (gym.spaces.Discrete(5, start=2), np.int64(4), (4.0,), ("action",)),
        (gym.spaces.Box(-1, 1, (2, 2)), [[1, 0], [0, 1]], (1.0, 0.0, 0.0, 1.0), tuple(f"action/{i}" for i in range(4))),
        (
            gym.spaces.Dict({"x": gym.spaces.Box(-1, 1, (2,)), "grip": gym.spaces.MultiBinary(1)}),
            {"x": np.array([0.5, -0.5], np.float32), "grip": np.array([1], np.int8)},
            (1.0, 0.5, -0.5),
            ("action/0", "action/1", "action/2"),
        ),
    ],
    ids=["discrete", "matrix", "dict"],
)
def test_actions_of_any_space_become_numbers(space, action, values, names):
    env = RopeEnv()
    env.action_space = space
    env.step = lambda given: RopeEnv.step(env, np.zeros(1))  # type: ignore[method-assign]
    with EnvSource(env, actions=lambda _: action) as source:
        assert (source.read().number, source.read().number) == (0, 1)
        assert source.robot_info.action == names
        assert source.transition is not None
        assert source.transition.action == values
