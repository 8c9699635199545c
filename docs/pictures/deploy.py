"""The picture of 'Deploy a policy': uv run python docs/pictures/deploy.py."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from sheet import FIRST_KEY, GOAL_KEY, HIDDEN_KEY, VALID_KEY, grid, legend, titled
from stages import write

from shape_obs import ShapeGoal, ShapeObservation, Target
from shape_obs.deploy import Limits, Step, deploy
from shape_obs.drawing import GOAL, draw_detection
from shape_obs_envs.robots import SimulatedRobot

sys.path.append(str(Path(__file__).parents[2] / "examples"))

from deploy_loop import EndsFirst

VIEW, LETTERS = (slice(160, 720), slice(230, 1050)), 30  # of pictures twice as large


def main() -> None:
    robot = SimulatedRobot(seed=4, difficulty="near")
    robot.connect()
    robot.reset()
    goal = Target.read(robot.goal)
    robot.disconnect()
    env = ShapeGoal(
        ShapeObservation(gym.make("shape_obs_envs:ShapeObs/D455-v0", source="robot", robot=robot)),
        goal=goal,
        threshold=0.015,
    )
    shown: dict[str, np.ndarray] = {}

    def look(moment: Step) -> None:
        if moment.step == 40:
            robot.disturb(occluder=0.9, seed=5)
        hidden = np.count_nonzero(~moment.detection.shapes[0].visible)
        name = "step 0" if moment.step == 0 else "step 40" if moment.step == 40 else ""
        if 4 <= hidden <= 7 and moment.step > 40 and "hand" not in shown:
            name = "hand"
        if name:
            shown[name] = picture(moment, env)

    deploy(env, EndsFirst(), Limits(hold=3), steps=160, on_step=look)
    titles = {
        "step 0": "Step 0",
        "step 40": "Step 40: at the goal",
        "hand": "A hand over an end",
    }
    panels = []
    for name, title in titles.items():
        panels.append(titled(shown[name], title, LETTERS))
    sheet = grid(panels, 2)
    keys = legend([VALID_KEY, FIRST_KEY, HIDDEN_KEY, GOAL_KEY], sheet.shape[1], LETTERS)
    write("deploy.jpg", np.concatenate([keys, sheet]))


def picture(moment: Step, env: Any) -> np.ndarray:
    assert moment.frame is not None
    assert moment.frame.rgb is not None
    under = [(target.points2d, GOAL) for target in env.targets]
    return draw_detection(moment.frame.rgb, moment.detection, scale=2, size=2.0, under=under)[VIEW]


if __name__ == "__main__":
    main()
