"""Stage: an environment's object, grippers and camera, one physics step at a time, for whoever keeps time himself."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.engine import mujoco
from shape_obs_envs.mujoco.goal_env import SUBSTEPS, ShapeGoalEnv
from shape_obs_envs.mujoco.scene import TIMESTEP
from shape_obs_envs.mujoco.workspace import Workspace

Array = NDArray[np.float64]


class Stage:
    """What a simulation in real time needs of an environment.

    Poses are (G, 3): x, y [m] and yaw [rad] for each gripper of a rope or ring, x, y, z [m] for those of a cloth.

    Args:
        env: The id of one of the simulated environments, such as "ShapeObs/Cable-v0".
        **options: Those of the environment; its camera has 640 x 480 pixels unless they say otherwise.

    Raises:
        ValueError: Another environment, or one of its arguments is out of its range.

    Attributes:
        env: The environment.
        dt: Seconds of a physics step.
    """

    dt = TIMESTEP

    def __init__(self, env: str, **options: Any) -> None:
        # Drawn when somebody looks, not at each reset.
        try:
            made = gym.make(env, **{"camera": "d455", **options, "render_observation": False}).unwrapped
        except (gym.error.Error, TypeError) as error:  # no such id; an argument that it does not know
            raise ValueError(f"env: {env!r} with {options} is none of the simulated environments: {error}") from error
        if not isinstance(made, ShapeGoalEnv):
            raise ValueError(f"env: expected a simulated environment such as 'ShapeObs/Cable-v0', got {env!r}.")
        self.env: Any = made  # with what its class publishes besides
        self._body, self._steps = made._body, 0

    @property
    def workspace(self) -> Workspace:
        """Where the grippers may go."""
        return self.env._workspace

    def restart(self, seed: int | None = None) -> Array:
        """Draw a new start, but no goal, which takes longer; the grippers' poses (G, 3)."""
        self.env.reset(seed=seed, options={"goal": self.env._goal})
        return self._body.gripper_targets().copy()

    def draw_goal(self, start: Array, seed: int | None = None) -> Array:
        """Points (n, 3) [m] of a goal that can be reached from `start`, which `state` gave; the scene becomes that."""
        self.env.reset(seed=seed, options={"start": start})
        return self.env._goal.reshape(-1, 3).astype(np.float64)

    def state(self) -> Array:
        """The whole physics state."""
        return self.env.get_state()

    def advance(self, poses: Array) -> None:
        """One physics step with the grippers at `poses` (G, 3)."""
        self._body.set_grippers(poses)
        mujoco.mj_step(self._body.model, self._body.data)
        self._steps += 1
        if self._steps % SUBSTEPS == 0:
            self.env._randomizer.advance()

    def look(self) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """What the camera sees now: RGB (H, W, 3) uint8, and depth (H, W) [m]."""
        self._body.refresh()
        return self.env._studio.capture(self._body)

    def points(self) -> Array:
        """True points (n, 3) [m] of the object as its goals tell them, of the last `look`."""
        return self.env._goal_points()

    def anchors(self) -> dict[str, tuple[float, ...]]:
        """Where the grippers hold the object, of the last `look`: name -> (x, y, z) [m]."""
        return {name: tuple(place) for name, place in self.env.anchors.items()}

    def close(self) -> None:
        """Free the camera."""
        self.env.close()
