"""Reachable goals: shapes that random gripper motions lead to, near the start or far from it; and reset options."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from shape_obs_envs.arguments import one_of

Array = NDArray[np.float64]
Actions = NDArray[np.float32]
#: A corner (x, y, z) of a box in metres, base frame.
Corner = tuple[float, float, float]

#: Bounds of all points of an object on the table in metres, base frame.
TABLE: Final[tuple[Corner, Corner]] = (-0.4, -0.4, 0.0), (0.4, 0.4, 0.1)
#: Steps at rest before a goal is recorded: a shape that is still relaxing could be reached but not kept.
SETTLING = 20
_LONGEST = 32
_DRAWS = 30


class Difficulty(NamedTuple):
    """Distance of goals from the start.

    Args:
        least: Smallest mean distance in metres; nearer goals are redrawn.
        most: Largest mean distance in metres, never exceeded.
        vigour: Initial strength of the gripper motion, 0 ... 1.
        bent: Whether the motion leads to an S bend or a fold.
        restless: Largest motion in metres in the last quarter of the rest; restless goals are redrawn.
    """

    least: float
    most: float
    vigour: float
    bent: bool
    restless: float


DIFFICULTIES: Final = {
    "near": Difficulty(0.015, 0.05, 0.5, False, 0.0005),
    "middle": Difficulty(0.03, 0.1, 1.0, False, 0.0005),
    "far": Difficulty(0.06, float("inf"), 1.0, True, 0.001),
}


class Goal(NamedTuple):
    """A reachable goal.

    Args:
        points: Points of shape ``(n, 3)``, in metres, base frame.
        actions: Actions of shape ``(T, A)`` that lead to it.
    """

    points: Array
    actions: Actions


def draw_goal(
    difficulty: Difficulty,
    start: Array,
    draw_motion: Callable[[float, bool], Actions],
    play: Callable[[Actions], tuple[Array, Array]],
) -> Goal:
    """Play random motions until one leads to a goal at the requested distance.

    Args:
        difficulty: Requested distance.
        start: Points of the start shape, ``(n, 3)``, in metres.
        draw_motion: Draws a motion of a given vigour, with a strong bend or without.
        play: Plays a motion from the start state and returns the points ``(n, 3)`` shortly before and at the end of the
            rest.

    Returns:
        The goal, never further away than ``difficulty.most``. If thirty motions lead nearer than ``difficulty.least``
        or do not come to rest, the furthest of them.
    """
    vigour, best, reached = difficulty.vigour, Goal(start, draw_motion(0.0, False)[:0]), -1.0
    for _ in range(_DRAWS):
        actions = draw_motion(vigour, difficulty.bent)
        nearly, points = play(actions)
        away = _mean_distance(points, start)
        if reached < away <= difficulty.most:
            best, reached = Goal(points, actions), away
        if difficulty.least < away <= difficulty.most and _mean_distance(nearly, points) < difficulty.restless:
            return Goal(points, actions)
        if away > difficulty.most:
            vigour *= max(0.9 * difficulty.most / away, 0.3)
    return best


def smooth_actions(rng: np.random.Generator, size: int, vigour: float) -> Actions:
    """Draw a random gripper motion of shape ``(T, size)``, T at most 35, that starts and ends at rest."""
    steps = int(rng.integers(18, _LONGEST + 1))
    knots = np.zeros((5, size))
    knots[1:-1] = vigour * rng.uniform(-1, 1, (3, size))
    at = np.linspace(0, len(knots) - 1, steps)
    actions = np.column_stack([np.interp(at, np.arange(len(knots)), knot) for knot in knots.T])
    return np.concatenate([actions, np.zeros((3, size))]).astype(np.float32)


def actions_towards(rng: np.random.Generator, start: Array, end: Array, step: Array) -> Actions:
    """Draw a gripper motion from poses ``start`` to poses ``end``, with varying speed and a detour.

    Args:
        rng: Random generator.
        start: Poses of shape ``(G, D)``.
        end: Poses of shape ``(G, D)``.
        step: Largest motion of a step, shape ``(D,)``.

    Returns:
        Actions of shape ``(T, A)``, T at most 35.
    """
    steps = _LONGEST
    time = np.linspace(0, 1, steps + 1)
    ease = time**2 * (3 - 2 * time)
    bulge = rng.uniform(-0.15, 0.15, start.shape) * np.abs(end - start).max(axis=0)
    path = start + ease[:, None, None] * (end - start) + np.sin(np.pi * time)[:, None, None] ** 2 * bulge
    actions = np.clip(np.diff(path, axis=0) / step, -1, 1).reshape(steps, -1)
    return np.concatenate([actions, np.zeros((3, actions.shape[1]))]).astype(np.float32)


def measured_space(bounds: tuple[Corner, Corner]) -> list[list[float]]:
    """Return bounds of measured points: they scatter, also into the table, and clipping them would bias their mean."""
    low, high = bounds
    return [[*low[:2], low[2] - 0.1], [*high[:2], high[2] + 0.1]]


def mean_point_distance(achieved: Any, desired: Any) -> Array:
    """Return the mean distance in metres of corresponding points in flat point lists ``(..., 3 n)``; shape (...,)."""
    achieved, desired = np.asarray(achieved, np.float64), np.asarray(desired, np.float64)
    if achieved.shape != desired.shape or achieved.ndim == 0 or achieved.shape[-1] == 0 or achieved.shape[-1] % 3:
        raise ValueError(
            "expected two goals of equal shape (..., 3 n), x y z of each point in a row, "
            f"got {achieved.shape} and {desired.shape}"
        )
    difference = (achieved - desired).reshape(*achieved.shape[:-1], -1, 3)
    return np.sqrt((difference**2).sum(axis=-1)).mean(axis=-1)


def read_options(options: Mapping[str, Any], goals: Box) -> dict[str, Any]:
    """Return the reset options "start" (float64) and "goal" (float32, flat) as new arrays, None if not given.

    Args:
        options: The argument of ``reset``.
        goals: Space of goals.

    Raises:
        ValueError: An option is unknown, or the goal is invalid.
    """
    for key in options:
        one_of("options", key, ("start", "goal"))
    out: dict[str, Any] = {"start": None, "goal": None}
    if options.get("start") is not None:
        out["start"] = np.asarray(options["start"], np.float64)
    if options.get("goal") is not None:
        goal: NDArray[np.float32] = np.asarray(options["goal"], np.float32)
        size = len(goals.low)
        if goal.size != size or not goals.contains(goal.ravel()):
            low, high = (tuple(np.round(bound[:3], 6).tolist()) for bound in (goals.low, goals.high))
            raise ValueError(
                f"options['goal']: expected {size // 3} points (x, y, z) in metres in the base frame within "
                f"{low} ... {high}, got an array of shape {goal.shape}: {goal.ravel()[:6]} ..."
            )
        out["goal"] = goal.ravel().copy()
    return out


def _mean_distance(one: Array, other: Array) -> float:
    """Return the mean distance in metres of corresponding points ``(n, 3)``."""
    return float(np.linalg.norm(one - other, axis=1).mean())
