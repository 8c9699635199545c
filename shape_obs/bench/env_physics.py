"""Whether the simulated objects behave: states stay finite, the engine does not complain, nothing stretches.

The goals of the simulated environments: how far they are from the start, and whether they are reached and kept.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.bench.env_speed import Env, make_env
from shape_obs.bench.tables import at_most

Array = npt.NDArray[np.float64]


class Strain(NamedTuple):
    """How much longer an object is than at rest; 0.05 is five hundredths.

    Args:
        whole: Of its length from end to end or once around; of a sheet, the same as ``local``.
        local: Of the piece between two neighbouring joints or masses that is stretched most.
    """

    whole: float
    local: float


def is_finite(simulator: Any) -> bool:
    """Whether the whole physics state is."""
    return bool(np.isfinite(simulator.get_state()).all())


def warnings(simulator: Any) -> int:
    """How often MuJoCo has warned since the object was last put down."""
    return int(np.sum(simulator._body.data.warning.number))


def strain(simulator: Any) -> Strain:
    """Of a rope's or band's middle line, or of the edges between a sheet's masses."""
    body, kind = simulator._body, simulator.goal_layout["kind"]
    if kind == "surface":
        return Strain(body.stretch(), body.stretch())
    if kind == "contour":
        line = body.axis()
        return _of_pieces(np.concatenate([line, line[:1]]), np.full(len(line), body.spec.link_length))
    line, spec = body.vertices(), body.spec
    rest = np.full(len(line) - 1, spec.link_length)
    rest[[0, -1]] += spec.radius
    return _of_pieces(line, rest)


def _of_pieces(line: Array, rest: Array) -> Strain:
    pieces = np.linalg.norm(np.diff(line, axis=0), axis=1)
    return Strain(float(pieces.sum() / rest.sum() - 1), float((pieces / rest).max() - 1))


Row = dict[str, Any]


DIFFICULTIES: Final = ("near", "middle", "far")

_REST: Final = 20  # steps after which the object should have come to rest

_FARTHEST: Final = {"near": 50, "middle": 100}  # millimetres, in every episode

_KEPT: Final = 5  # millimetres


class GoalResult(NamedTuple):
    """Goals of one difficulty, and what their own actions lead to; millimetres between corresponding points, mean.

    Args:
        env: The environment.
        difficulty: How far goals should be.
        episodes: How many.
        start_mm: From the start to the goal, mean over the episodes.
        farthest_mm: In the episode where that is most.
        played_mm: Left over after the goal's actions and a second of rest, mean over the episodes.
        worst_played_mm: In the worst episode.
        warnings: Of MuJoCo.
    """

    env: Env
    difficulty: str
    episodes: int
    start_mm: float
    farthest_mm: float
    played_mm: float
    worst_played_mm: float
    warnings: int


def goals(
    env: Env, difficulty: str, seeds: Sequence[int], tick: Callable[[int], object] = lambda done: None
) -> GoalResult:
    """Draw a goal in each episode and play the actions that lead to it, without drawing images."""
    simulated = make_env(env, {"render_observation": False, "difficulty": difficulty})
    simulator: Any = simulated.unwrapped
    starts: list[float] = []
    ends: list[float] = []
    complaints = 0
    for seed in seeds:
        _, info = simulated.reset(seed=seed)
        starts.append(1e3 * info["truth/mean_error"])
        idle = np.zeros((_REST, *simulator.action_space.shape), np.float32)
        for action in [*simulator.goal_actions, *idle]:
            *_, info = simulated.step(action)
        ends.append(1e3 * info["truth/mean_error"])
        complaints += warnings(simulator)
        tick(1)
    simulated.close()
    return GoalResult(
        env,
        difficulty,
        len(starts),
        start_mm=float(np.mean(starts)),
        farthest_mm=max(starts),
        played_mm=float(np.mean(ends)),
        worst_played_mm=max(ends),
        warnings=complaints,
    )


def asked_rows(found: Sequence[GoalResult]) -> list[Row]:
    """What is asked of goals, what was seen."""
    asked: list[Row] = []
    for each in found:
        what = f"{each.env}, {each.difficulty}"
        if each.difficulty in _FARTHEST:
            farthest = f"{what}: the farthest goal from its start"
            asked.append(at_most(farthest, _FARTHEST[each.difficulty], each.farthest_mm, " mm"))
        asked.append(at_most(f"{what}: off the worst goal after its actions", _KEPT, each.worst_played_mm, " mm"))
    return asked
