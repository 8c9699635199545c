"""Domain randomisation: light, looks, camera, material, distractors and a hand, drawn from the environment's seed."""

from shape_obs_envs.mujoco.randomization.randomizer import Randomizer
from shape_obs_envs.mujoco.randomization.spec import Randomization

__all__ = ["Randomization", "Randomizer"]
