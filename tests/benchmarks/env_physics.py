"""Make simulated environments for measurements, and check their physics and their goals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, get_args

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from tests.benchmarks import Difficulty, Env, ServoEnv
from tests.benchmarks.tables import Row, at_most, mean

Array = npt.NDArray[np.float64]
Actions = npt.NDArray[np.float32]

EPISODE: Final = 50  # steps
DIFFICULTIES: Final = get_args(Difficulty)
_REST: Final = 20  # steps after which the object should have come to rest
_FARTHEST: Final = {"near": 50, "middle": 100}  # target in millimetres, in every episode
_KEPT: Final = 5  # target in millimetres


def make_env(name: ServoEnv, options: Mapping[str, Any]) -> gym.Env[Any, Any]:
    """Make an environment as trainers do, without Gymnasium's checker; it never ends an episode by itself."""
    return gym.make(f"shape_obs_envs:ShapeObs/{name}-v0", disable_env_checker=True, max_episode_steps=-1, **options)


def held_actions(rng: np.random.Generator, shape: tuple[int, ...], steps: int, held: int = 1) -> Actions:
    """Draw (steps, *shape) random actions, each held for ``held`` steps; white noise moves grippers less."""
    drawn = rng.uniform(-1, 1, (-(-steps // held), *shape))
    return np.repeat(drawn, held, axis=0)[:steps].astype(np.float32)


def is_finite(simulator: Any) -> bool:
    """Return whether the whole physics state is finite."""
    return bool(np.isfinite(simulator.get_state()).all())


def warnings(simulator: Any) -> int:
    """Return the number of MuJoCo's warnings since the last reset of the object."""
    return int(np.sum(simulator._body.data.warning.number))


def strain(simulator: Any) -> tuple[float, float]:
    """Return how much longer an object is than at rest, in all and at most between two neighbouring joints or masses.

    A strain of 0.05 is five percent. That of a rope or a band is measured along its middle line; both values of a sheet
    are the largest strain of an edge between its masses.
    """
    body, kind = simulator._body, simulator.goal_layout["kind"]
    if kind == "surface":
        return body.stretch(), body.stretch()
    if kind == "contour":
        line = body.axis()
        line, rest = np.concatenate([line, line[:1]]), np.full(len(line), body.spec.link_length)
    else:
        line = body.vertices()
        rest = np.full(len(line) - 1, body.spec.link_length)
        rest[[0, -1]] += body.spec.radius
    pieces = np.linalg.norm(np.diff(line, axis=0), axis=1)
    return float(pieces.sum() / rest.sum() - 1), float((pieces / rest).max() - 1)


def goals(env: Env, difficulty: str, seeds: Sequence[int]) -> Row:
    """Draw a goal in each episode and play the actions that lead to it, without rendering.

    Returns:
        Means over the episodes and the largest values, in millimetres between corresponding points: ``start_mm`` and
        ``farthest_mm``: distance of the start from the goal; ``played_mm`` and ``worst_played_mm``: distance left after
        the goal's own actions and a second of rest. ``warnings``: of MuJoCo.
    """
    simulated = make_env(env, {"render_observation": False, "difficulty": difficulty})
    simulator: Any = simulated.unwrapped
    starts: list[float] = []
    ends: list[float] = []
    warned = 0
    for seed in seeds:
        _, info = simulated.reset(seed=seed)
        starts.append(1e3 * info["truth/mean_error"])
        idle = np.zeros((_REST, *simulator.action_space.shape), np.float32)
        for action in [*simulator.goal_actions, *idle]:
            *_, info = simulated.step(action)
        ends.append(1e3 * info["truth/mean_error"])
        warned += warnings(simulator)
    simulated.close()
    return Row(
        env=env,
        difficulty=difficulty,
        episodes=len(starts),
        start_mm=mean(starts),
        farthest_mm=max(starts),
        played_mm=mean(ends),
        worst_played_mm=max(ends),
        warnings=warned,
    )


def targets(found: Sequence[Row]) -> list[Row]:
    """Compare goals with their targets."""
    rows: list[Row] = []
    for each in found:
        what = f"{each.env}, {each.difficulty}"
        if each.difficulty in _FARTHEST:
            farthest = f"{what}: the farthest goal from its start"
            rows.append(at_most(farthest, _FARTHEST[each.difficulty], each.farthest_mm, " mm"))
        rows.append(at_most(f"{what}: off the worst goal after its actions", _KEPT, each.worst_played_mm, " mm"))
    return rows
