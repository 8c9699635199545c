"""How near a policy brings the shape to its goal, in millimetres of the true points.

Scores as CSV: a line for each episode.
"""

from __future__ import annotations
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple
import gymnasium as gym
import numpy as np
import csv
import io
from collections.abc import Iterable
from pathlib import Path
from typing import Final
from shape_obs.ablation.training_run import Row


Act = Callable[[Any], Any]



class Score(NamedTuple):
    """One episode.

    Attributes:
        difficulty: How far the goal was.
        seed: Of start and goal.
        start_mm: Mean distance of the true points from the true goal's, millimetres, in the beginning.
        final_mm: After the last step.
        success: Whether it is below the environment's ``success_threshold`` after the last step.
        ms: What a step took with the policy, milliseconds.
    """

    difficulty: str
    seed: int
    start_mm: float
    final_mm: float
    success: bool
    ms: float



def play(
    env: gym.Env[Any, Any], act: Act, difficulties: Sequence[str], seeds: Sequence[int], steps: int
) -> Iterator[Score]:
    """Play episodes: every seed of every difficulty.

    Args:
        env: A simulated environment as the policy knows it, with ``truth/mean_error`` in its ``info``.
        act: An action for an observation.
        difficulties: Of the environment.
        seeds: Of starts and goals.
        steps: Of an episode.
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
    """Share of the goals that were reached."""
    return float(np.mean([score.success for score in scores]))



SCORES: Final = "scores.csv"

COLUMNS: Final = ("steps", "disturbance", "difficulty", "goal", "start_mm", "final_mm", "success", "ms")



def scores_csv(rows: Iterable[Row]) -> str:
    """The file's text; ``goal`` is the seed of start and goal, millimetres have four digits behind the point."""
    out = io.StringIO()
    table = csv.writer(out, lineterminator="\n")
    table.writerow(COLUMNS)
    table.writerows(cells(row) for row in rows)
    return out.getvalue()



def cells(row: Row) -> tuple[object, ...]:
    """A line of the file, in the order of ``COLUMNS``."""
    score = row.score
    return (
        row.steps, row.disturbance, score.difficulty, score.seed,
        f"{score.start_mm:.4f}", f"{score.final_mm:.4f}", int(score.success), f"{score.ms:.3f}",
    )  # fmt: skip



def read_scores(path: Path) -> list[Row]:
    """The scores of a file.

    Raises:
        FileNotFoundError: There is none.
        ValueError: It is none.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = [_row(line) for line in csv.DictReader(file)]
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        raise ValueError(f"{path}: expected a table of {', '.join(COLUMNS)} ({error!r}).") from error
    if not rows:
        raise ValueError(f"{path}: expected a score in each line, it has none.")
    return rows



def _row(line: dict[str, str]) -> Row:
    score = Score(
        line["difficulty"], int(line["goal"]), float(line["start_mm"]), float(line["final_mm"]),
        bool(int(line["success"])), float(line["ms"]),
    )  # fmt: skip
    return Row(int(line["steps"]), line["disturbance"], score)

