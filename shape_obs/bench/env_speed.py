"""An environment on its way through episodes: steps to be timed by others, resets timed apart.

Steps per second of the simulated environments: without drawing, with images, wrapped, and as MuJoCo draws them.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from shape_obs.bench.backends import LABELS, Backend, backends
from shape_obs.bench.env_stock import StockDrawing
from shape_obs.bench.interleaved_timing import CLOCKS, Clock, Entrant, turns
from shape_obs.bench.tables import at_least, at_most
from shape_obs.utils.threads import one_thread
from shape_obs.wrappers import ShapeObservation

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


Row = dict[str, Any]

Size = tuple[int, int]


SIZES: Final[tuple[Size, ...]] = ((84, 84), (160, 120), (640, 480))

RENDERERS: Final = ("gl", "rays")

WARM_UP: Final = 10  # steps that are not counted

NOTHING, BARE, STOCK, PLAIN = "no drawing", "bare", "stock", "stock, no shadows"

# What is asked of the wrapped environment, as a share of the steps per second without drawing.
_TRAINING: Final = (84, 84)

_OF_NOTHING: Final[dict[Backend, float]] = {"numpy": 0.3, "numba": 0.4}

# What the wrapper may take of a wrapped step.
_USUAL: Final = (160, 120)

_SHARE: Final[dict[Backend, float]] = {"numpy": 35, "numba": 10}

_OVER_STOCK: Final = 5


@dataclass(frozen=True)
class Course:
    """What is run.

    Args:
        env: The environment.
        size: (width, height) of its images, pixels.
        renderer: ``"gl"`` or ``"rays"``.
        steps: How many are counted.
        slow: On how many of them MuJoCo's own settings run too; 0 leaves them out.
        seed: Of episodes and actions.
        clock: What counts the time.
        burst: Steps in a turn.
    """

    env: Env
    size: Size
    renderer: str
    steps: int
    slow: int = 0
    seed: int = 0
    clock: Clock = "wall"
    burst: int = 10

    @property
    def image(self) -> str:
        """As the tables call it."""
        return f"{self.size[0]} x {self.size[1]}"

    @property
    def options(self) -> dict[str, Any]:
        """Of the environment."""
        return {"camera": [*self.size], "renderer": self.renderer}


@dataclass
class Speed:
    """What one contestant took.

    Args:
        steps: Milliseconds of each step.
        wrapper: The share of each step that is not the environment's own; empty for those that are not wrapped.
        resets: Milliseconds of each reset.
    """

    steps: list[float] = field(default_factory=list)
    wrapper: list[float] = field(default_factory=list)
    resets: list[float] = field(default_factory=list)

    @property
    def rate(self) -> float:
        """Steps per second, of the median step."""
        return 1e3 / float(np.median(self.steps))


Speeds = dict[str, Speed]


def speeds(course: Course, tick: Callable[[], Any] = lambda: None) -> Speeds:
    """Let every way of running an environment live through the same episodes, in turns of a few steps.

    Args:
        course: What is run.
        tick: Called after each step of all.

    Returns:
        Contestant -> times, first without drawing, then with images, wrapped on each backend, and as MuJoCo draws.
    """
    found: Speeds = defaultdict(Speed)
    with ExitStack() as stack, one_thread():
        runners = {name: Runner(env, course.seed, course.clock) for name, env in _contestants(course, stack)}
        (shape,) = {runner.env.action_space.shape for runner in runners.values()}
        assert shape is not None
        actions = held_actions(np.random.default_rng(course.seed), shape, WARM_UP + course.steps)
        seldom = {*np.linspace(WARM_UP, len(actions) - 1, min(course.slow, course.steps)).astype(int).tolist()}
        # Once before, or its first step would be the only one that finds nothing ready.
        seldom.update(range(min(course.slow, 2)))
        entrants = [
            Entrant[Actions](name, runner.step, runner.ready, frames=seldom if name in (STOCK, PLAIN) else None)
            for name, runner in runners.items()
        ]
        last = -1
        for turn in turns(actions, entrants, course.clock, burst=course.burst):
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
    return {name: found[name] for name in runners}


def speed_row(course: Course, found: Speeds) -> Row:
    """Steps per second of each way, their ratios, the wrapper's share of a step, and what a reset takes."""
    row: Row = {"env": course.env, "image": course.image, "renderer": course.renderer}
    row |= {"no_drawing": found[NOTHING].rate, "bare": found[BARE].rate}
    row |= {backend: _rate(found, backend) for backend in LABELS}
    row |= {f"{backend}_of_no_drawing": _over(_rate(found, backend), found[NOTHING].rate) for backend in LABELS}
    row |= {f"{backend}_wrapper_percent": _percent(found.get(backend)) for backend in LABELS}
    return row | {"reset_ms": float(np.median(found[BARE].resets))}


def stock_row(course: Course, found: Speeds) -> Row:
    """Steps per second as MuJoCo draws by itself, and how many times faster the environment draws."""
    row: Row = {"env": course.env, "image": course.image, "bare": found[BARE].rate}
    row |= {"stock": found[STOCK].rate, "stock_no_shadows": found[PLAIN].rate}
    row |= {"faster": found[BARE].rate / found[STOCK].rate}
    return row | {"faster_no_shadows": found[BARE].rate / found[PLAIN].rate}


def speed_claims(rows: Sequence[Row], stock: Sequence[Row]) -> list[Row]:
    """What is asked of training with OpenGL, what was seen.

    Args:
        rows: Of ``speed_row``.
        stock: Of ``stock_row``.
    """
    asked: list[Row] = []
    for row in rows:
        if row["renderer"] != "gl":
            continue
        what = f"{row['env']}, {row['image']}, OpenGL"
        for backend, label in LABELS.items():
            if row["env"] == "Cable" and row["image"] == _name(_TRAINING):
                told = f"{what}, wrapped, {label}: of the steps per second without drawing"
                asked.append(at_least(told, _OF_NOTHING[backend], row[f"{backend}_of_no_drawing"]))
            if row["image"] == _name(_USUAL):
                told = f"{what}: the wrapper's share of a wrapped step, {label}"
                asked.append(at_most(told, _SHARE[backend], row[f"{backend}_wrapper_percent"], " %"))
    for row in stock:
        what = f"{row['env']}, {row['image']}, OpenGL: times the steps per second of stock mujoco.Renderer"
        asked.append(at_least(what, _OVER_STOCK, row["faster"]))
    return asked


def _contestants(course: Course, stack: ExitStack) -> Iterator[tuple[str, Any]]:
    """Name -> environment; each is closed with the stack."""

    def opened(env: Any) -> Any:
        stack.callback(env.close)
        return env

    def bare(**options: Any) -> Any:
        return make_env(course.env, {**course.options, **options})

    yield NOTHING, opened(bare(render_observation=False))
    yield BARE, opened(bare())
    for backend in backends():
        yield backend, opened(ShapeObservation(Stopwatch(bare(), course.clock), backend=backend))
    if course.slow and course.renderer == "gl":
        for name in (STOCK, PLAIN):
            yield name, opened(StockDrawing(bare(render_observation=False), *course.size, shadows=name == STOCK))


def _rate(found: Speeds, name: str) -> float | None:
    return found[name].rate if name in found else None


def _over(value: float | None, other: float) -> float | None:
    return None if value is None else value / other


def _percent(speed: Speed | None) -> float | None:
    return None if speed is None else 100 * float(np.median(speed.wrapper))


def _name(size: Size) -> str:
    return f"{size[0]} x {size[1]}"
