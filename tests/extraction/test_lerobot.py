"""LeRobot datasets: their files as LeRobot v3 reads them. ``.ci/lerobot`` opens some with the real lerobot."""

from __future__ import annotations

import json
import shutil
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("pyarrow")
pytest.importorskip("mujoco")

import pyarrow
from noise_frames import camera_of
from pyarrow import parquet

from shape_obs import CameraModel, Frame, Intrinsics, ShapeDetector, save_config
from shape_obs.cli import main
from shape_obs.config.config_file import detector_arguments, load_config
from shape_obs.recording import Moment, Recording, RecordingWriter, RobotInfo, Transition, record, replay
from shape_obs.robot import ActionSpec
from shape_obs_envs.sources import open_source

N, LENGTH = 8, 5
ROPE = {"kind": "centerline", "name": "rope", "n": N, "anchor": "gripper0", "ends": "tips", "spacing": "m"}
BLUE = {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]}


def read(made, name):
    return json.loads((made / "meta" / f"{name}.json").read_text())


def rows(made):
    return parquet.read_table(made / "data" / "chunk-000" / "file-000.parquet")


def array(table, name):
    return np.asarray(table[name].to_pylist())


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Return a folder with a config and two recordings of a cable, of two and one episodes and a bit."""
    folder = tmp_path_factory.mktemp("place")
    save_config(folder / "c.yaml", {"shapes": [ROPE], "segmentation": BLUE})
    options = {"actions": "random", "renderer": "rays", "camera": (96, 72), "max_episode_steps": LENGTH}
    for seed, frames in ((0, 2 * (LENGTH + 1)), (1, LENGTH + 4)):
        with open_source("ShapeObs/Cable-v0", seed=seed, **options) as source:
            record(source, folder / f"r{seed}", frames=frames)
    return folder


@pytest.fixture(scope="module")
def made(place):
    """Return the LeRobot dataset of the two recordings, with videos if they can be encoded."""
    command = ["extract", str(place / "r0"), str(place / "r1"), "--config", str(place / "c.yaml"), "--to", "lerobot"]
    try:
        import imageio_ffmpeg  # noqa: F401

        command.append("--videos")
    except ImportError:
        pass
    with pytest.raises(SystemExit) as stop:
        main([*command, "--task", "shape the rope", "-o", str(place / "made")])
    assert stop.value.code == 0
    return place / "made"


def test_info_describes_the_columns_of_the_rows(made):
    info, table = read(made, "info"), rows(made)
    assert (info["codebase_version"], info["fps"]) == ("v3.0", 20)
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (4, 3 * LENGTH + 2, 1)
    assert info["splits"] == {"train": "0:4"}
    assert info["robot_type"] == "ShapeObs/Cable-v0"
    stored = {name: feature for name, feature in info["features"].items() if feature["dtype"] != "video"}
    assert table.column_names == list(stored)
    types = {"float32": pyarrow.float32(), "int64": pyarrow.int64(), "bool": pyarrow.bool_()}
    for name, feature in stored.items():
        (size,) = feature["shape"]
        scalar = types[feature["dtype"]]
        assert table.schema.field(name).type == (scalar if size == 1 else pyarrow.list_(scalar, size)), name
        assert feature["names"] is None or len(feature["names"]) == size, name
        assert "/" not in name
    names = stored["observation.state"]["names"]
    assert names[:4] == ["rope/points3d/0/x", "rope/points3d/0/y", "rope/points3d/0/z", "rope/points3d/1/x"]
    assert names[3 * N] == "robot/gripper/0"
    assert stored["action"]["names"][:2] == ["gripper0/x", "gripper0/y"]


def test_rows_are_shapes_with_the_action_that_was_chosen_for_them(place, made):
    detector = ShapeDetector(**detector_arguments(load_config(place / "c.yaml")))
    table, at = rows(made), 0
    states, actions = array(table, "observation.state"), array(table, "action")
    for name in ("r0", "r1"):
        with open_source(place / name) as source:
            pairs = list(replay(source, detector))
        for (moment, detection), (after, _) in pairwise(pairs):
            if after.episode != moment.episode:
                continue
            rope, step = detection["rope"], after.transition
            assert step is not None
            assert rope.valid.all()
            assert np.abs(states[at][: 3 * N] - np.ravel(np.asarray(rope.points3d))).max() < 1e-6
            assert np.array_equal(states[at][3 * N :], np.asarray(moment.state, np.float32))
            assert np.array_equal(actions[at], np.asarray(step.action, np.float32))
            assert table["next.reward"][at].as_py() == np.float32(step.reward)
            assert table["next.done"][at].as_py() == (step.terminated or step.truncated)
            assert table["next.truncated"][at].as_py() == step.truncated
            at += 1
    assert at == len(table)
    assert np.array_equal(array(table, "observation.environment_state"), states[:, : 3 * N])
    assert array(table, "next.done").sum() == 3, "the last recording ended in an episode"
    assert array(table, "shape.ok").all()
    assert array(table, "shape.measured").all()


def test_indices_and_episodes_fit_together(made):
    table, lengths = rows(made), [LENGTH, LENGTH, LENGTH, 2]
    assert array(table, "index").tolist() == list(range(sum(lengths)))
    assert array(table, "episode_index").tolist() == [i for i, length in enumerate(lengths) for _ in range(length)]
    assert array(table, "frame_index").tolist() == [i for length in lengths for i in range(length)]
    assert np.allclose(array(table, "timestamp"), array(table, "frame_index") / 20)
    episodes = parquet.read_table(made / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
    assert episodes["length"].to_pylist() == lengths
    assert episodes["dataset_to_index"].to_pylist() == np.cumsum(lengths).tolist()
    assert episodes["dataset_from_index"].to_pylist() == [0, *np.cumsum(lengths)[:-1].tolist()]
    assert episodes["tasks"].to_pylist() == 4 * [["shape the rope"]]
    assert set(episodes["data/file_index"].to_pylist()) == {0}
    tasks = parquet.read_table(made / "meta" / "tasks.parquet")
    assert tasks.to_pydict() == {"task_index": [0], "__index_level_0__": ["shape the rope"]}
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["__index_level_0__"]


def test_statistics_are_those_of_the_rows(made):
    stats, table = read(made, "stats"), rows(made)
    episodes = parquet.read_table(made / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
    first = array(table, "episode_index") == 0
    for name in table.column_names:
        values = array(table, name).reshape(len(table), -1).astype(float)
        found = stats[name]
        assert found["count"] == [len(table)]
        for kind in ("min", "max", "mean", "std"):
            assert np.allclose(found[kind], getattr(values, kind)(axis=0)), (name, kind)
            assert np.allclose(episodes[f"stats/{name}/{kind}"][0].as_py(), getattr(values[first], kind)(axis=0))
        for kind, share in (("q01", 0.01), ("q50", 0.5), ("q99", 0.99)):
            own = np.quantile(values[first], share, axis=0)
            assert np.allclose(episodes[f"stats/{name}/{kind}"][0].as_py(), own), (name, kind)


def test_videos_show_the_frames_of_the_rows(place, made):
    pytest.importorskip("imageio_ffmpeg")
    info, recording = read(made, "info"), Recording(place / "r0")
    feature = info["features"]["observation.images.camera"]
    assert (feature["dtype"], feature["shape"], feature["names"]) == (
        "video",
        [72, 96, 3],
        ["height", "width", "channels"],
    )
    episodes = parquet.read_table(made / "meta" / "episodes" / "chunk-000" / "file-000.parquet").to_pylist()
    for number, episode in enumerate(episodes):
        entry = {name.rpartition("/")[2]: value for name, value in episode.items() if name.startswith("videos/")}
        assert (entry["from_timestamp"], entry["to_timestamp"]) == (0.0, episode["length"] / 20)
        path = made / info["video_path"].format(video_key="observation.images.camera", **entry)
        capture = cv2.VideoCapture(str(path))
        frames = []
        while (got := capture.read())[0]:
            frames.append(got[1][..., ::-1])
        assert len(frames) == episode["length"]
        if number < 2:
            for i, frame in enumerate(frames):
                original = np.asarray(recording[number * (LENGTH + 1) + i].frame.rgb)
                assert np.abs(frame.astype(int) - original).mean() < 4
    assert np.asarray(read(made, "stats")["observation.images.camera"]["mean"]).shape == (3, 1, 1)


def test_a_second_run_keeps_the_shapes_and_replaces_the_dataset(place, made, tmp_path, extract):
    out = tmp_path / "again"
    shutil.copytree(made, out)
    (out / ".lerobot.0123").mkdir()  # left by a run that was killed
    before = {path.name: path.stat().st_mtime_ns for path in (out / "extraction").glob("*.parquet")}
    for options in (["--fps", "29.97"], []):
        code, result, err = extract(place / "r0", "--config", place / "c.yaml", "--to", "lerobot", "-o", out, *options)
        assert (code, result["kept"], result["lerobot"]["episodes"]) == (0, 2, 2), err
        assert (read(out, "info")["fps"], result["lerobot"]["task"]) == (29.97, "shape the rope")
        tasks = parquet.read_table(out / "meta" / "tasks.parquet")
        assert tasks["__index_level_0__"].to_pylist() == ["shape the rope"]
        for said in ("2 episodes in", "lasts 0.167 s at 29.97 frames a second, but 0.25 s by its stamps"):
            assert said in err
        assert ("videos of the existing dataset are removed" in err) == bool(options and (made / "videos").is_dir())
    assert {name: (out / "extraction" / name).stat().st_mtime_ns for name in before} == before
    assert sorted(path.name for path in out.iterdir()) == ["data", "extraction", "meta"]
    (out / "meta" / "info.json").write_text("{}")  # by another program
    again = (place / "r0", "--config", place / "c.yaml", "--to", "lerobot", "-o", out)
    code, _, err = extract(*again)
    assert (code, read(out, "info")) == (1, {})
    assert "was changed since: give --overwrite" in err
    shutil.rmtree(out / "meta")  # as a run that was killed while it replaced them
    assert extract(*again)[0] == 0


def test_recordings_without_a_robot_give_observations_only(place, tmp_path, extract):
    with open_source(place / "r0") as source, RecordingWriter(tmp_path / "flat", source, depth=False) as writer:
        for _ in range(4):
            writer.add(Moment(source.read(), {"gripper0": (20.0, 30.0)}))
    save_config(tmp_path / "c.yaml", {"shapes": [{"kind": "centerline", "n": N}], "segmentation": BLUE})
    code, result, err = extract(
        tmp_path / "flat", "--config", tmp_path / "c.yaml", "--to", "lerobot", "-o", tmp_path / "out"
    )
    assert code == 0, err
    assert result["lerobot"]["frames"] == 4
    assert result["lerobot"]["features"]["observation.environment_state"] == [2 * N]
    assert "action" not in result["lerobot"]["features"]
    names = read(tmp_path / "out", "info")["features"]["observation.environment_state"]["names"]
    assert names[:2] == ["centerline/points2d_normalized/0/u", "centerline/points2d_normalized/0/v"]


@pytest.mark.parametrize(
    ("arguments", "wanted", "message"),
    [
        (["--task", "x"], 2, "--task, --videos and --fps belong to --to lerobot"),
        (["--to", "lerobot", "--fps", "0"], 2, "--fps: expected a number above 0"),
        (["--to", "lerobot", "-o", "r0"], 1, "r0: the folder is not empty, and holds no extraction"),
    ],
)
def test_mistakes_are_reported_before_the_work(place, extract, monkeypatch, arguments, wanted, message):
    monkeypatch.chdir(place)
    out = [] if "-o" in arguments else ["-o", "new"]
    code, result, err = extract("r0", "--config", "c.yaml", *arguments, *out)
    assert (code, result) == (wanted, None)
    assert message in err
    assert not Path("new").exists()


def test_recordings_of_unlike_robots_are_refused(place, tmp_path, extract):
    options = {"actions": "random", "renderer": "rays", "camera": (96, 72), "grippers": 1}
    with open_source("ShapeObs/Cable-v0", seed=0, **options) as source:
        record(source, tmp_path / "one", frames=3)
    code, _, err = extract(
        place / "r0", tmp_path / "one", "--config", place / "c.yaml", "--to", "lerobot", "-o", tmp_path / "out"
    )
    assert code == 1
    assert "its action, observation.state differ from those of the episodes before" in err
    assert not (tmp_path / "out" / "meta").exists()


# ---- where nothing was sent, and where frames were dropped


def write_run(folder, spec, transitions):
    """Record frames of a drawn rope with the given steps; the state of the robot is (0.1, 0.2)."""
    intrinsics = Intrinsics(96, 72, 90.0, 90.0, 47.5, 35.5)
    rgb, depth = np.full((72, 96, 3), 200, np.uint8), np.full((72, 96), 700, np.uint16)
    cv2.line(rgb, (15, 30), (80, 40), (20, 60, 200), 5)
    frames = [Frame(rgb, depth, CameraModel(intrinsics), i / 10, number=i) for i in range(len(transitions))]
    with RecordingWriter(folder, camera_of(frames), robot=RobotInfo("arm", spec.names, spec.names, spec)) as writer:
        for frame, transition in zip(frames, transitions, strict=True):
            writer.add(Moment(frame, {}, 0, transition, (0.1, 0.2)))


@pytest.mark.parametrize(("mode", "still"), [("displacement", [0.0, 0.0]), ("position", [0.5, 1.0])])
def test_where_nothing_was_sent_the_action_keeps_the_robot_still(tmp_path, extract, mode, still):
    spec = ActionSpec(("x", "y"), ("m", "m"), (0.2, 0.2), (-1.0, -1.0), (1.0, 1.0), mode=mode)
    steps = [Transition(1, (0.5, -0.5), 0.0), Transition(2, None, 0.0), Transition(3, (1.0, 0.0), 1.0, True)]
    write_run(tmp_path / "run", spec, [Transition(0), *steps])
    save_config(tmp_path / "c.yaml", {"shapes": [{"kind": "centerline", "n": N}], "segmentation": BLUE})
    code, _, err = extract(tmp_path / "run", "--config", tmp_path / "c.yaml", "--to", "lerobot", "-o", tmp_path / "out")
    assert code == 0, err
    table = rows(tmp_path / "out")
    assert array(table, "action").tolist() == [[0.5, -0.5], still, [1.0, 0.0]]
    assert array(table, "next.done").tolist() == [False, False, True]
    assert read(tmp_path / "out", "info")["fps"] == 10
    assert np.allclose(array(table, "observation.state")[:, -2:], (0.1, 0.2))


def test_frames_before_a_dropped_one_are_left_out_and_reported(tmp_path, extract):
    spec = ActionSpec(("x", "y"), ("m", "m"), (0.2, 0.2), (-1.0, -1.0), (1.0, 1.0))
    write_run(tmp_path / "run", spec, [Transition(0), *(Transition(i, (i / 10, 0.0), 0.0) for i in (1, 3, 4))])
    save_config(tmp_path / "c.yaml", {"shapes": [{"kind": "centerline", "n": N}], "segmentation": BLUE})
    code, _, err = extract(tmp_path / "run", "--config", tmp_path / "c.yaml", "--to", "lerobot", "-o", tmp_path / "out")
    assert code == 0
    assert "1 frames are left out: the frame after them was dropped" in err
    assert array(rows(tmp_path / "out"), "action")[:, 0].tolist() == [np.float32(0.1), np.float32(0.4)]
