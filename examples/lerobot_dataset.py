"""Record demonstrations with a simulated rope, and write them as a LeRobot dataset of shapes and actions.

The demonstrations lead to each episode's goal: the environment knows the actions by which it drew the goal. LeRobot is
not needed to write the dataset; in an environment that has it, ``LeRobotDataset("local/rope", root="rope")`` opens it.

Run: ``uv run --extra sim --extra parquet examples/lerobot_dataset.py``
"""

import json
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pyarrow.parquet

from shape_obs.extraction import Extraction, all_tasks, extract
from shape_obs.extraction.lerobot import write_lerobot
from shape_obs.recording import record
from shape_obs_envs.sources import EnvSource, open_source

EPISODES = 3
CONFIG: dict[str, Any] = {
    "shapes": [{"kind": "centerline", "name": "rope", "n": 20, "anchor": "gripper0", "ends": "tips", "spacing": "m"}],
    "segmentation": {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]},
    "features": ["points3d"],
}


def demonstrations() -> str:
    """Return a folder with recorded episodes, each of which ends at its goal."""
    env = gym.make("shape_obs_envs:ShapeObs/Cable-v0", renderer="rays", max_episode_steps=25)
    inner: Any = env.unwrapped

    def act(_):
        """Follow the way by which the goal was drawn, then stand still."""
        done = 0 if source.transition is None else source.transition.step
        return inner.goal_actions[done] if done < len(inner.goal_actions) else np.zeros(6, np.float32)

    with EnvSource(env, actions=act, seed=0) as source:
        print(record(source, "demonstrations", frames=EPISODES * 26))
    return "demonstrations"


tasks = all_tasks([demonstrations()])
job = Extraction(CONFIG, Path("rope/extraction"), open_source)
for outcome in extract(job, tasks):
    print(outcome.status, outcome.frames, "frames, ok in", outcome.ok)
summary = write_lerobot(job, tasks, Path("rope"), task="bring the rope to its goal")
print(summary.episodes, "episodes,", summary.frames, "rows at", summary.fps, "Hz:", dict(summary.features))

names = json.loads(Path("rope/meta/info.json").read_text())["features"]["action"]["names"]
table = pyarrow.parquet.read_table("rope/data/chunk-000/file-000.parquet")
rewards = table["next.reward"].to_numpy().reshape(EPISODES, -1)
print("actions of", names)
print("rewards at the start", rewards[:, 0].round(3), "and at the end", rewards[:, -1].round(3))
