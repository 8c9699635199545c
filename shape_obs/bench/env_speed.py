"""Measure the steps per second of the simulated environments: without rendering, with images, and wrapped."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any, Final

import gymnasium as gym
import numpy as np

from shape_obs.bench import Clock, Env, Size
from shape_obs.bench.env_physics import EPISODE, Actions, held_actions, make_env
from shape_obs.bench.interleaved_timing import CLOCKS, Method, interleaved_timing
from shape_obs.bench.tables import Row, at_least, at_most
from shape_obs.utils.threads import one_thread
from shape_obs.wrappers import ShapeObservation

WARM_UP: Final = 10  # steps that are not counted
NO_RENDERING, BARE, WRAPPED = "no_drawing", "bare", "wrapped"
_TRAINING: Final = "84 x 84"
_OF_NO_RENDERING: Final = 0.4  # target: share of the steps per second without rendering
_USUAL: Final = "160 x 120"
_WRAPPER_PERCENT: Final = 10  # target: the wrapper's share of a wrapped step


@dataclass(frozen=True)
class Course:
    """The environment that is measured.

    Args:
        env: The environment.
        size: (width, height) of its images in pixels.
        renderer: ``"gl"`` or ``"rays"``.
        steps: Number of counted steps.
        seed: Seed of episodes and actions.
        clock: The clock.
        burst: Steps in a turn.
    """

    env: Env
    size: Size
    renderer: str
    steps: int
    seed: int = 0
    clock: Clock = "wall"
    burst: int = 10

    @property
    def image(self) -> str:
        """The image size as in the tables."""
        return f"{self.size[0]} x {self.size[1]}"


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
        begin = self._now()
        self.env.reset(seed=self._seed + 1000 * len(self.resets))
        self.resets.append(1e3 * (self._now() - begin))
        self._left = EPISODE

    def step(self, action: Actions) -> None:
        """Take one step."""
        self._left -= 1
        self.env.step(action)


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
        begin = self._now()
        result = self.env.step(action)
        self.milliseconds = 1e3 * (self._now() - begin)
        return result


@dataclass
class Speed:
    """The times of one way of running an environment.

    Args:
        steps: Milliseconds of each step.
        wrapper: Share of each step outside the environment's own step; empty if it is not wrapped.
        resets: Milliseconds of each reset.
    """

    steps: list[float] = field(default_factory=list)
    wrapper: list[float] = field(default_factory=list)
    resets: list[float] = field(default_factory=list)

    @property
    def rate(self) -> float:
        """Steps per second at the median step."""
        return 1e3 / float(np.median(self.steps))


def speeds(course: Course, tick: Callable[[], Any] = lambda: None) -> dict[str, Speed]:
    """Run the same episodes without rendering, with images and wrapped, in turns of a few steps.

    Args:
        course: The environment that is measured.
        tick: Called after each step of all.

    Returns:
        Name of the way -> times.
    """
    found: dict[str, Speed] = defaultdict(Speed)
    with ExitStack() as stack, one_thread():
        runners = {name: Runner(env, course.seed, course.clock) for name, env in _ways(course, stack)}
        (shape,) = {runner.env.action_space.shape for runner in runners.values()}
        assert shape is not None
        actions = held_actions(np.random.default_rng(course.seed), shape, WARM_UP + course.steps)
        methods = [Method[Actions](name, runner.step, runner.ready) for name, runner in runners.items()]
        last = -1
        for turn in interleaved_timing(actions, methods, course.clock, burst=course.burst):
            if turn.frame > last:
                tick()
                last = turn.frame
            if turn.frame < WARM_UP:
                continue
            speed = found[turn.name]
            speed.steps.append(turn.milliseconds)
            inside = getattr(runners[turn.name].env, "env", None)
            if isinstance(inside, Stopwatch):
                speed.wrapper.append(1 - inside.milliseconds / turn.milliseconds)
        for name, runner in runners.items():
            found[name].resets = runner.resets
    return dict(found)


def _ways(course: Course, stack: ExitStack) -> Iterator[tuple[str, gym.Env[Any, Any]]]:
    """Make the environments by name; each is closed with the stack."""
    options = {"camera": [*course.size], "renderer": course.renderer}
    for name, render in ((NO_RENDERING, False), (BARE, True), (WRAPPED, True)):
        env = make_env(course.env, options if render else {**options, "render_observation": False})
        if name == WRAPPED:
            env = ShapeObservation(Stopwatch(env, course.clock))
        stack.callback(env.close)
        yield name, env


def speed_row(course: Course, found: dict[str, Speed]) -> Row:
    """Return the steps per second of each way, the wrapper's share of a step, and the time of a reset."""
    rates: Row = {name: found[name].rate for name in (NO_RENDERING, BARE, WRAPPED)}
    return {
        "env": course.env,
        "image": course.image,
        "renderer": course.renderer,
        **rates,
        "wrapped_of_no_drawing": rates[WRAPPED] / rates[NO_RENDERING],
        "wrapper_percent": 100 * float(np.median(found[WRAPPED].wrapper)),
        "reset_ms": float(np.median(found[BARE].resets)),
    }


def speed_targets(rows: Sequence[Row]) -> list[Row]:
    """Compare the rows of ``speed_row`` with the targets for training with OpenGL."""
    compared: list[Row] = []
    for row in rows:
        what = f"{row['env']}, {row['image']}, OpenGL"
        if row["renderer"] != "gl":
            continue
        if row["env"] == "Cable" and row["image"] == _TRAINING:
            share = row["wrapped_of_no_drawing"]
            compared.append(
                at_least(f"{what}, wrapped: of the steps per second without drawing", _OF_NO_RENDERING, share)
            )
        if row["image"] == _USUAL:
            percent = row["wrapper_percent"]
            compared.append(at_most(f"{what}: the wrapper's share of a wrapped step", _WRAPPER_PERCENT, percent, " %"))
    return compared
