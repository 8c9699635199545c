"""Make LeRobot datasets and what they must contain, run by .ci/lerobot in the environment of this project."""

from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from shape_obs import ShapeDetector
from shape_obs.cli import main
from shape_obs.config.config_file import detector_arguments, load_config
from shape_obs.recording import Recording, record, replay
from shape_obs_envs.sources import open_source

CONFIG = """version: 1
shape:
  shapes:
    - {kind: centerline, name: rope, n: 20, anchor: gripper0, ends: tips, spacing: m}
scene:
  segmentation: {kind: hsv, low: [100, 120, 40], high: [125, 255, 255]}
"""


def expected(folder: Path) -> dict[str, np.ndarray[Any, Any]]:
    """Return what a recording contains, found by a detector of its own: a row for each frame that a step followed."""
    detector = ShapeDetector(**detector_arguments(load_config(folder.parent / "shape.yaml")))
    rows: dict[str, list[Any]] = {name: [] for name in ("points", "state", "action", "reward", "done", "rgb")}
    with open_source(folder) as source:
        pairs = [(moment, detection["rope"]) for moment, detection in replay(source, detector)]
    for (moment, rope), (following, _) in pairwise(pairs):
        step = following.transition
        if step is None or step.action is None:  # the next episode begins
            continue
        assert rope.valid.all(), "every point is measured in these recordings"
        rows["points"].append(np.asarray(rope.points3d).ravel())
        rows["state"].append(moment.state)
        rows["action"].append(step.action)
        rows["reward"].append(step.reward)
        rows["done"].append(step.terminated or step.truncated)
        rows["rgb"].append(moment.frame.rgb)
    return {name: np.asarray(values) for name, values in rows.items()}


if __name__ == "__main__":
    out = Path(sys.argv[1])
    out.mkdir()
    (out / "shape.yaml").write_text(CONFIG)
    options: dict[str, Any] = {"actions": "random", "camera": (320, 240), "max_episode_steps": 12}
    for seed in range(2):
        with open_source("ShapeObs/Cable-v0", seed=seed, **options) as source:
            print(record(source, out / f"r{seed}", frames=39))
    found = [expected(out / f"r{seed}") for seed in range(2)]
    np.savez(out / "expected.npz", **{name: np.concatenate([each[name] for each in found]) for name in found[0]})
    print("episodes", [sorted(set(Recording(out / f"r{seed}").episodes)) for seed in range(2)])
    for name, extra in (("plain", []), ("videos", ["--videos"])):
        command = ["extract", str(out / "r0"), str(out / "r1"), "--config", str(out / "shape.yaml"), "--to", "lerobot"]
        try:
            main([*command, "--task", "shape the rope", "-o", str(out / name), *extra])
        except SystemExit as stop:
            if stop.code:
                raise
