"""Actions in LeRobot datasets: where none was sent, and where frames were dropped."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

pytest.importorskip("pyarrow")

from lerobot_files import array, read, rows, run
from noise_frames import camera_of

from shape_obs import CameraModel, Frame, Intrinsics, save_config
from shape_obs.recording import Moment, RecordingWriter, RobotInfo, Transition
from shape_obs.robot import ActionSpec

N = 8
BLUE = {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]}


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
def test_where_nothing_was_sent_the_action_keeps_the_robot_still(tmp_path, capsys, mode, still):
    spec = ActionSpec(("x", "y"), ("m", "m"), (0.2, 0.2), (-1.0, -1.0), (1.0, 1.0), mode=mode)
    steps = [Transition(1, (0.5, -0.5), 0.0), Transition(2, None, 0.0), Transition(3, (1.0, 0.0), 1.0, True)]
    write_run(tmp_path / "run", spec, [Transition(0), *steps])
    save_config(tmp_path / "c.yaml", {"shapes": [{"kind": "centerline", "n": N}], "segmentation": BLUE})
    code, _, err = run(
        capsys, tmp_path / "run", "--config", tmp_path / "c.yaml", "--to", "lerobot", "-o", tmp_path / "out"
    )
    assert code == 0, err
    table = rows(tmp_path / "out")
    assert array(table, "action").tolist() == [[0.5, -0.5], still, [1.0, 0.0]]
    assert array(table, "next.done").tolist() == [False, False, True]
    assert read(tmp_path / "out", "info")["fps"] == 10
    assert np.allclose(array(table, "observation.state")[:, -2:], (0.1, 0.2))


def test_frames_before_a_dropped_one_are_left_out_and_reported(tmp_path, capsys):
    spec = ActionSpec(("x", "y"), ("m", "m"), (0.2, 0.2), (-1.0, -1.0), (1.0, 1.0))
    write_run(tmp_path / "run", spec, [Transition(0), *(Transition(i, (i / 10, 0.0), 0.0) for i in (1, 3, 4))])
    save_config(tmp_path / "c.yaml", {"shapes": [{"kind": "centerline", "n": N}], "segmentation": BLUE})
    code, _, err = run(
        capsys, tmp_path / "run", "--config", tmp_path / "c.yaml", "--to", "lerobot", "-o", tmp_path / "out"
    )
    assert code == 0
    assert "1 frames are left out: the frame after them was dropped" in err
    assert array(rows(tmp_path / "out"), "action")[:, 0].tolist() == [np.float32(0.1), np.float32(0.4)]
