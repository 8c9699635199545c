"""An environment on its way through episodes: steps to be timed by others, resets timed apart."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Literal

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from shape_obs.bench.turns import CLOCKS, Clock

Actions = npt.NDArray[np.float32]
Env = Literal["Cable", "Ring", "Cloth"]

ENVS: Final[tuple[Env, ...]] = ("Cable", "Ring", "Cloth")
EPISODE: Final = 50  # steps


def make_env(name: Env, options: Mapping[str, Any]) -> gym.Env[Any, Any]:
    """An environment as trainers make it, without Gymnasium's checker; it never ends an episode by itself."""
    return gym.make(f"shape_obs_envs:ShapeObs/{name}-v0", disable_env_checker=True, max_episode_steps=-1, **options)


class Runner:
    """Steps an environment, or several as a vector, and resets it when an episode is over.

    Args:
        env: An environment or a vector of them.
        seed: Of the first episode; the following ones count on, so that equal runners live through equal episodes.
        clock: What counts the time of resets.

    Attributes:
        resets: What they took, milliseconds.
    """

    def __init__(self, env: gym.Env[Any, Any] | gym.vector.VectorEnv[Any, Any, Any], seed: int, clock: Clock) -> None:
        self.env, self.resets = env, list[float]()
        self._seed, self._now, self._left = seed, CLOCKS[clock], 0

    def ready(self) -> None:
        """Reset where the next step needs it."""
        if self._left:
            return
        begin = self._now()
        self.env.reset(seed=self._seed + 1000 * len(self.resets))
        self.resets.append(1e3 * (self._now() - begin))
        self._left = EPISODE

    def step(self, action: Actions) -> None:
        """One step; its result is not looked at."""
        self._left -= 1
        self.env.step(action)


class Stopwatch(gym.Wrapper[Any, Any, Any, Any]):
    """Between an environment and its wrapper: tells how long the environment's own last step took.

    Args:
        env: The environment.
        clock: What counts the time.

    Attributes:
        milliseconds: Of the last step.
    """

    def __init__(self, env: gym.Env[Any, Any], clock: Clock) -> None:
        super().__init__(env)
        self.milliseconds = 0.0
        self._now = CLOCKS[clock]

    def step(self, action: Any) -> Any:
        """Step the environment."""
        begin = self._now()
        result = self.env.step(action)
        self.milliseconds = 1e3 * (self._now() - begin)
        return result


def held_actions(rng: np.random.Generator, shape: tuple[int, ...], steps: int, held: int = 1) -> Actions:
    """(steps, *shape) random actions, each of them taken ``held`` times: white noise moves grippers much less."""
    drawn = rng.uniform(-1, 1, (-(-steps // held), *shape))
    return np.repeat(drawn, held, axis=0)[:steps].astype(np.float32)
