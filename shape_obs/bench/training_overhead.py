"""What share of a training's time the wrapper takes, beside the same training on the simulator's points."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any, Final, Literal

import gymnasium as gym

from shape_obs.bench.backends import LABELS, backends
from shape_obs.bench.env_speed import EPISODE
from shape_obs.bench.interleaved_timing import CLOCKS, Clock, Entrant, turns
from shape_obs.bench.tables import at_most
from shape_obs.utils.threads import one_thread
from shape_obs.wrappers import ShapeObservation

Row = dict[str, Any]
Size = tuple[int, int]
Algorithm = Literal["SAC", "PPO"]

ALGORITHMS: Final[tuple[Algorithm, ...]] = ("SAC", "PPO")
SIZES: Final[tuple[Size, ...]] = ((84, 84), (160, 120))
TRUTH: Final = "true state"
#: Steps in a turn: SAC learns after each of them, PPO after all of them.
_TURN: Final[dict[Algorithm, int]] = {"SAC": 50, "PPO": 256}
# What is asked: percent of the wall time.
_ASKED: Final[dict[Algorithm, float]] = {"SAC": 10.0}
_ASKED_AT: Final = "84 x 84"
_FLOOR: Final = 1e-4  # m2, of VecNormalize


@dataclass(frozen=True)
class Course:
    """What is trained.

    Args:
        algorithm: ``"SAC"``, with hindsight replay and a sparse reward, or ``"PPO"``, with a dense one.
        size: (width, height) of the images, pixels.
        steps: How many are counted at least; turns are whole.
        renderer: ``"auto"``, ``"gl"`` or ``"rays"``.
        seed: Of episodes and networks.
        clock: What counts the time.
    """

    algorithm: Algorithm
    size: Size
    steps: int
    renderer: str = "auto"
    seed: int = 0
    clock: Clock = "wall"

    @property
    def image(self) -> str:
        """As the tables call it."""
        return f"{self.size[0]} x {self.size[1]}"

    @property
    def turn(self) -> int:
        """Steps in a turn."""
        return min(_TURN[self.algorithm], self.steps)

    @property
    def warm_up(self) -> int:
        """Steps before those that are counted: SAC collects two episodes."""
        return 2 * self.turn if self.algorithm == "PPO" else 2 * EPISODE

    @property
    def counted(self) -> int:
        """Steps of all turns together."""
        return -(-self.steps // self.turn) * self.turn


@dataclass
class Overhead:
    """What the counted steps of one training took, milliseconds.

    Attributes:
        learning: All of it: environment, wrapper, network.
        wrapped: In the environment and the wrapper, resets too.
        env: In the environment alone.
    """

    learning: float = 0.0
    wrapped: float = 0.0
    env: float = 0.0

    @property
    def percent(self) -> float:
        """Of the whole time, in the wrapper."""
        return 100 * (self.wrapped - self.env) / self.learning


class Meter(gym.Wrapper[Any, Any, Any, Any]):
    """Adds up the time in the environment inside.

    Args:
        env: The environment.
        clock: What counts the time.

    Attributes:
        milliseconds: In steps and resets so far.
    """

    def __init__(self, env: gym.Env[Any, Any], clock: Clock) -> None:
        super().__init__(env)
        self.milliseconds = 0.0
        self._now = CLOCKS[clock]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Reset the environment."""
        begin = self._now()
        result = self.env.reset(seed=seed, options=options)
        self.milliseconds += 1e3 * (self._now() - begin)
        return result

    def step(self, action: Any) -> Any:
        """Step the environment."""
        begin = self._now()
        result = self.env.step(action)
        self.milliseconds += 1e3 * (self._now() - begin)
        return result


def overheads(course: Course, tick: Callable[[int], Any] = lambda steps: None) -> dict[str, Overhead]:
    """Train the same on the simulator's points and on the wrapper's, on each backend, in turns and on one thread.

    What happens once is not counted: the first steps, in which SAC does not learn yet.

    Args:
        course: What is trained.
        tick: Called with the number of steps after each turn.

    Returns:
        What is seen -> times.
    """
    with ExitStack() as stack:
        trained = {name: (_model(course, outer), outer, inner) for name, outer, inner in _metered(course, stack)}
        found = {name: Overhead() for name in trained}
        with one_thread(), _torch_alone():
            for model, *_ in trained.values():
                model.learn(course.warm_up)
            before = {name: (outer.milliseconds, inner.milliseconds) for name, (_, outer, inner) in trained.items()}
            entrants = [
                Entrant[int](name, lambda steps, model=model: model.learn(steps, reset_num_timesteps=False))
                for name, (model, *_) in trained.items()
            ]
            for turn in turns([course.turn] * (course.counted // course.turn), entrants, course.clock):
                found[turn.name].learning += turn.milliseconds
                tick(course.turn)
        for name, (_, outer, inner) in trained.items():
            found[name].wrapped = outer.milliseconds - before[name][0]
            found[name].env = inner.milliseconds - before[name][1]
    return found


def overhead_rows(course: Course, found: dict[str, Overhead]) -> list[Row]:
    """A row for each thing that is seen: milliseconds of a step, the wrapper's share, times the true state's time."""
    rows = []
    for name, overhead in found.items():
        row: Row = {"algorithm": course.algorithm, "image": course.image, "sees": name}
        row |= {"ms_per_step": overhead.learning / course.counted, "env_ms": overhead.env / course.counted}
        row |= {"wrapper_ms": (overhead.wrapped - overhead.env) / course.counted, "wrapper_percent": overhead.percent}
        rows.append(row | {"times_true_state": overhead.learning / found[TRUTH].learning})
    return rows


def overhead_claims(rows: Sequence[Row]) -> list[Row]:
    """What is asked of the wrapper, what was seen."""
    claims = []
    for row in rows:
        asked = _ASKED.get(row["algorithm"])
        if asked is not None and row["image"] == _ASKED_AT and row["sees"] != TRUTH:
            what = f"{row['algorithm']}, {row['image']}, {row['sees']}: the wrapper's share of a training"
            claims.append(at_most(what, asked, row["wrapper_percent"], " %"))
    return claims


def _metered(course: Course, stack: ExitStack) -> Iterator[tuple[str, Meter, Meter]]:
    """What is seen, the environment with its wrapper, and without; each is closed with the stack."""
    from shape_obs.training import TrueState

    options = {
        "camera": [*course.size],
        "renderer": course.renderer,
        "reward_type": "sparse" if course.algorithm == "SAC" else "dense",
        "disable_env_checker": True,
    }

    def metered(wrap: Callable[[Meter], gym.Env[Any, Any]], **more: Any) -> tuple[Meter, Meter]:
        inner = Meter(gym.make("shape_obs_envs:ShapeObs/Cable-v0", **options, **more), course.clock)
        outer = Meter(wrap(inner), course.clock)
        stack.callback(outer.close)
        return outer, inner

    yield TRUTH, *metered(TrueState, render_observation=False)
    for backend in backends():
        yield LABELS[backend], *metered(lambda env, backend=backend: ShapeObservation(env, backend=backend))


def _model(course: Course, env: gym.Env[Any, Any]) -> Any:
    """As the examples train it."""
    import stable_baselines3 as sb3
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    from shape_obs.training import GoalDifference

    vector = VecNormalize(DummyVecEnv([lambda: env]), norm_reward=course.algorithm == "PPO", epsilon=_FLOOR)
    policy: dict[str, Any] = {"features_extractor_class": GoalDifference}
    common = {"gamma": 0.95, "seed": course.seed, "device": "cpu"}
    if course.algorithm == "PPO":
        rest: dict[str, Any] = {"n_steps": course.turn, "batch_size": min(128, course.turn), "n_epochs": 10}
        return sb3.PPO("MultiInputPolicy", vector, policy_kwargs=policy, **rest, **common)
    return sb3.SAC(
        "MultiInputPolicy", vector, policy_kwargs={**policy, "net_arch": [256, 256]}, batch_size=128,
        replay_buffer_class=sb3.HerReplayBuffer, learning_starts=course.warm_up, buffer_size=100_000, **common,
    )  # fmt: skip


@contextmanager
def _torch_alone() -> Iterator[None]:
    """Hold torch, whose threads are its own, to one of them."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
