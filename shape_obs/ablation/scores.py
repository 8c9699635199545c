"""Score policies by the true distance of the shape from its goal, and store the scores as CSV."""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import gymnasium as gym
import numpy as np

Act = Callable[[Any], Any]

SCORES: Final = "scores.csv"
COLUMNS: Final = ("steps", "disturbance", "difficulty", "goal", "start_mm", "final_mm", "success", "ms")


class Score(NamedTuple):
    """The score of one episode.

    Attributes:
        difficulty: Difficulty of the goal.
        seed: Seed of start and goal.
        start_mm: Mean distance of the true points from those of the goal at the start, in millimetres.
        final_mm: The same distance after the last step.
        success: Whether ``final_mm`` is below the environment's ``success_threshold``.
        ms: Duration of a step with the policy, in milliseconds.
    """

    difficulty: str
    seed: int
    start_mm: float
    final_mm: float
    success: bool
    ms: float


@dataclass(frozen=True)
class Row:
    """The score of one episode at some time of a training.

    Attributes:
        steps: Steps of training before the evaluation.
        disturbance: Name of the disturbance; empty for none.
        score: Score of the episode.
    """

    steps: int
    disturbance: str
    score: Score


def play(
    env: gym.Env[Any, Any], act: Act, difficulties: Sequence[str], seeds: Sequence[int], steps: int
) -> Iterator[Score]:
    """Run one episode for every seed of every difficulty, and yield its score.

    Args:
        env: A simulated environment with the policy's wrappers, and ``truth/mean_error`` in its ``info``.
        act: Returns the action for an observation.
        difficulties: Difficulties of the environment.
        seeds: Seeds of starts and goals.
        steps: Steps of an episode.
    """
    simulator: Any = env.unwrapped
    for difficulty in difficulties:
        simulator.difficulty = difficulty
        for seed in seeds:
            observation, info = env.reset(seed=seed)
            first = float(info["truth/mean_error"])
            begin = time.perf_counter()
            for _ in range(steps):
                observation, _, _, _, info = env.step(act(observation))
            ms = 1e3 * (time.perf_counter() - begin) / steps
            last = float(info["truth/mean_error"])
            reached = last < simulator.success_threshold
            yield Score(difficulty, seed, 1e3 * first, 1e3 * last, bool(reached), ms)


def success(scores: Sequence[Score]) -> float:
    """Return the fraction of goals that were reached."""
    return float(np.mean([score.success for score in scores]))


def scores_csv(rows: Iterable[Row]) -> str:
    """Return scores as CSV with one line per episode; ``goal`` is the seed of start and goal."""
    out = io.StringIO()
    table = csv.writer(out, lineterminator="\n")
    table.writerow(COLUMNS)
    table.writerows(cells(row) for row in rows)
    return out.getvalue()


def cells(row: Row) -> tuple[object, ...]:
    """Return a line of the file, in the order of ``COLUMNS``."""
    score = row.score
    return (
        row.steps, row.disturbance, score.difficulty, score.seed,
        f"{score.start_mm:.4f}", f"{score.final_mm:.4f}", int(score.success), f"{score.ms:.3f}",
    )  # fmt: skip


def read_scores(path: Path) -> list[Row]:
    """Read the scores of a file.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is not a table of scores.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = [_row(line) for line in csv.DictReader(file)]
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        raise ValueError(f"{path}: expected a table of {', '.join(COLUMNS)} ({error!r}).") from error
    if not rows:
        raise ValueError(f"{path}: expected a score in each line, got an empty table.")
    return rows


def _row(line: dict[str, str]) -> Row:
    score = Score(
        line["difficulty"], int(line["goal"]), float(line["start_mm"]), float(line["final_mm"]),
        bool(int(line["success"])), float(line["ms"]),
    )  # fmt: skip
    return Row(int(line["steps"]), line["disturbance"], score)
