"""Goals that can be reached: shapes that a random gripper motion leads to, near the start or far from it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Actions = NDArray[np.float32]

#: Steps at rest before a goal is recorded: a goal that is still relaxing could be reached but not kept.
SETTLING = 20
_LONGEST = 32
_DRAWS = 30


class Difficulty(NamedTuple):
    """How far goals are from the start.

    Args:
        least: Mean distance [m] below which a goal is drawn again.
        most: Mean distance [m] that is never exceeded.
        vigour: How strongly the grippers are moved at first, 0 ... 1.
        bent: Whether the motion leads to an S bend or a fold.
        restless: How far [m] the object may still move in the last quarter of the rest; else it is drawn again.
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
        points: (n, 3) [m], base frame.
        actions: (T, A) the motion that leads to it.
    """

    points: Array
    actions: Actions


def mean_distance(one: Array, other: Array) -> float:
    """Mean distance [m] of corresponding points (n, 3)."""
    return float(np.linalg.norm(one - other, axis=1).mean())


def draw_goal(
    difficulty: Difficulty,
    start: Array,
    draw_motion: Callable[[float, bool], Actions],
    play: Callable[[Actions], tuple[Array, Array]],
) -> Goal:
    """Play random motions until one leads to a goal that is as far away as the difficulty wants.

    Args:
        difficulty: What is wanted.
        start: (n, 3) the shape at the start [m].
        draw_motion: Draws a motion of a given vigour that leads to a strong bend or not.
        play: Plays a motion from the start state and returns the shape (n, 3) when the object has nearly come to
            rest, and when it should have.

    Returns:
        The goal; never further away than `difficulty.most`. After thirty draws that were all nearer than
        `difficulty.least` or did not come to rest, the furthest of them.
    """
    vigour, best, reached = difficulty.vigour, Goal(start, draw_motion(0.0, False)[:0]), -1.0
    for _ in range(_DRAWS):
        actions = draw_motion(vigour, difficulty.bent)
        nearly, points = play(actions)
        away = mean_distance(points, start)
        if reached < away <= difficulty.most:
            best, reached = Goal(points, actions), away
        if difficulty.least < away <= difficulty.most and mean_distance(nearly, points) < difficulty.restless:
            return Goal(points, actions)
        if away > difficulty.most:
            vigour *= max(0.9 * difficulty.most / away, 0.3)
    return best


def smooth_actions(rng: np.random.Generator, size: int, vigour: float) -> Actions:
    """A random gripper motion (T, size), T at most 35, that starts and ends at rest."""
    steps = int(rng.integers(18, _LONGEST + 1))
    knots = np.zeros((5, size))
    knots[1:-1] = vigour * rng.uniform(-1, 1, (3, size))
    at = np.linspace(0, len(knots) - 1, steps)
    actions = np.column_stack([np.interp(at, np.arange(len(knots)), knot) for knot in knots.T])
    return np.concatenate([actions, np.zeros((3, size))]).astype(np.float32)


def actions_towards(rng: np.random.Generator, start: Array, end: Array, step: Array) -> Actions:
    """A gripper motion (T, A), T at most 35, from poses `start` (G, D) to `end`, unevenly and by a detour.

    Args:
        rng: Draws the detour.
        start: (G, D) poses.
        end: (G, D) poses.
        step: (D,) largest motion of a step.
    """
    steps = _LONGEST
    time = np.linspace(0, 1, steps + 1)
    ease = time**2 * (3 - 2 * time)
    bulge = rng.uniform(-0.15, 0.15, start.shape) * np.abs(end - start).max(axis=0)
    path = start + ease[:, None, None] * (end - start) + np.sin(np.pi * time)[:, None, None] ** 2 * bulge
    actions = np.clip(np.diff(path, axis=0) / step, -1, 1).reshape(steps, -1)
    return np.concatenate([actions, np.zeros((3, actions.shape[1]))]).astype(np.float32)


def mean_point_distance(achieved: Any, desired: Any) -> Array:
    """Mean distance [m] of corresponding points of two flat point lists (..., 3 n); shape (...,)."""
    achieved, desired = np.asarray(achieved, np.float64), np.asarray(desired, np.float64)
    if achieved.shape != desired.shape or achieved.ndim == 0 or achieved.shape[-1] == 0 or achieved.shape[-1] % 3:
        raise ValueError(
            "expected two goals of equal shape (..., 3 n), x y z of each point in a row, "
            f"got {achieved.shape} and {desired.shape}"
        )
    apart = (achieved - desired).reshape(*achieved.shape[:-1], -1, 3)
    return np.sqrt((apart**2).sum(axis=-1)).mean(axis=-1)
