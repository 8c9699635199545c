"""Measure the steps per second of the simulated environments: without rendering, with images, and wrapped."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from typing import Any, Final

import gymnasium as gym
import numpy as np

from shape_obs.wrappers import ShapeObservation
from tests.benchmarks import Clock, Env, Size
from tests.benchmarks.envs import EPISODE, held_actions, make_env
from tests.benchmarks.interleaved_timing import CLOCKS, Method, Timing, Turn, median_ms, time_methods, timed
from tests.benchmarks.tables import Row, at_least, at_most

Actions = np.ndarray
WARM_UP: Final = 10  # steps that are not counted
NO_RENDERING, BARE, WRAPPED = "no_drawing", "bare", "wrapped"
_TRAINING: Final = "84 x 84"
_OF_NO_RENDERING: Final = 0.4  # target: share of the steps per second without rendering
_USUAL: Final = "160 x 120"
_WRAPPER_PERCENT: Final = 10  # target: the wrapper's share of a wrapped step


class Runner:
    """Step an environment, and reset it when an episode is over.

    Args:
        env: The environment.
        seed: Seed of the first episode; the seeds of later ones follow, so that equal runners see equal episodes.
        clock: The clock for resets.

    Attributes:
        resets: Milliseconds of each reset.
    """

    def __init__(self, env: gym.Env[Any, Any], seed: int, clock: Clock) -> None:
        self.env, self.resets = env, list[float]()
        self._seed, self._now, self._left = seed, CLOCKS[clock], 0

    def ready(self) -> None:
        """Reset if the next step needs it."""
        if self._left:
            return
        self.resets.append(timed(lambda: self.env.reset(seed=self._seed + 1000 * len(self.resets)), self._now)[1])
        self._left = EPISODE

    def step(self, action: Actions) -> float | None:
        """Take one step, and return the milliseconds of the step inside the wrapper, if there is one."""
        self._left -= 1
        self.env.step(action)
        inside = getattr(self.env, "env", None)
        return inside.milliseconds if isinstance(inside, Stopwatch) else None


class Stopwatch(gym.Wrapper[Any, Any, Any, Any]):
    """Time the steps of an environment inside its wrapper.

    Args:
        env: The environment.
        clock: The clock.

    Attributes:
        milliseconds: Time of the last step.
    """

    def __init__(self, env: gym.Env[Any, Any], clock: Clock) -> None:
        super().__init__(env)
        self.milliseconds = 0.0
        self._now = CLOCKS[clock]

    def step(self, action: Any) -> Any:
        """Step the environment."""
        result, self.milliseconds = timed(lambda: self.env.step(action), self._now)
        return result


def speed_row(env: Env, size: Size, renderer: str, steps: int, timing: Timing) -> Row:
    """Run the same episodes without rendering, with images and wrapped, in turns of a few steps.

    Args:
        env: The environment.
        size: (width, height) of its images in pixels.
        renderer: ``"gl"`` or ``"rays"``.
        steps: Number of counted steps.
        timing: Clock and number of steps in a turn; seed of episodes and actions.

    Returns:
        The steps per second of each way, the wrapper's share of a step, and the time of a reset.
    """
    options = {"camera": [*size], "renderer": renderer}
    envs = {
        NO_RENDERING: make_env(env, {**options, "render_observation": False}),
        BARE: make_env(env, options),
        WRAPPED: ShapeObservation(Stopwatch(make_env(env, options), timing.clock)),
    }
    with ExitStack() as stack:
        for each in envs.values():
            stack.callback(each.close)
        runners = {name: Runner(each, timing.seed, timing.clock) for name, each in envs.items()}
        actions = held_actions(np.random.default_rng(timing.seed), envs[BARE].action_space.shape or (), WARM_UP + steps)
        methods = [Method[Actions](name, runner.step, runner.ready) for name, runner in runners.items()]
        found = time_methods(actions, methods, timing, warm_up=WARM_UP)
    rates = {name: rate(some) for name, some in found.items()}
    return Row(
        env=env,
        image=f"{size[0]} x {size[1]}",
        renderer=renderer,
        **rates,
        wrapped_of_no_drawing=rates[WRAPPED] / rates[NO_RENDERING],
        wrapper_percent=100 * float(np.median([1 - turn.result / turn.milliseconds for turn in found[WRAPPED]])),
        reset_ms=float(np.median(runners[BARE].resets)),
    )


def rate(turns: Iterable[Turn]) -> float:
    """Return the steps per second at the median step."""
    return 1e3 / median_ms(turns)


def speed_targets(rows: Sequence[Row]) -> list[Row]:
    """Compare the rows of ``speed_row`` with the targets for training with OpenGL."""
    compared: list[Row] = []
    for row in rows:
        what = f"{row.env}, {row.image}, OpenGL"
        if row.renderer != "gl":
            continue
        if row.env == "Cable" and row.image == _TRAINING:
            whole = f"{what}, wrapped: of the steps per second without drawing"
            compared.append(at_least(whole, _OF_NO_RENDERING, row.wrapped_of_no_drawing))
        if row.image == _USUAL:
            share = f"{what}: the wrapper's share of a wrapped step"
            compared.append(at_most(share, _WRAPPER_PERCENT, row.wrapper_percent, " %"))
    return compared
