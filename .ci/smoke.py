"""What the built wheel must do on its own, run by .ci/run in an environment that has nothing else."""

import sys
from pathlib import Path

import cv2
import gymnasium as gym
import numpy as np

import shape_obs
import shape_obs_envs
from shape_obs import HSVRange, ShapeDetector, ShapeObservation

for package in (shape_obs, shape_obs_envs):
    home = Path(package.__file__).parent
    assert "site-packages" in home.parts, f"{package.__name__} comes from {home}, not from the wheel"
    assert (home / "py.typed").exists(), f"{package.__name__} has lost py.typed"

photo = np.full((120, 160, 3), 200, np.uint8)
cv2.line(photo, (20, 30), (140, 90), (20, 60, 200), 7)
rope = ShapeDetector(["centerline"], HSVRange(low=(90, 60, 30), high=(130, 255, 255))).detect(photo).shapes[0]
assert rope.ok, rope.reason
assert rope.points2d.shape == (20, 2), rope.points2d.shape

env = ShapeObservation(gym.make("ShapeObs/Cable-v0", renderer="rays"))
observation, _ = env.reset(seed=0)
observation, _, _, _, info = env.step(env.action_space.sample())
assert env.observation_space.contains(observation)
assert info["shape/ok"], info
env.close()

heavy = {"torch", "stable_baselines3", "matplotlib", "pyrealsense2"} & set(sys.modules)
assert not heavy, f"loaded for nothing: {heavy}"
print("the wheel detects a rope and steps the cable")
