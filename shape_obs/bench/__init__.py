"""Measure accuracy and speed against known truth: ``shape-obs bench``.

The options below are defined here so that a command can print its help without importing a measurement.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import starmap
from typing import Any, Final, Literal, TypeVar, get_args

T = TypeVar("T")
Clock = Literal["wall", "thread"]
Env = Literal["Cable", "Ring", "Cloth", "Hanging"]
ENVS: Final[tuple[Env, ...]] = get_args(Env)
Difficulty = Literal["near", "middle", "far"]  # distance of a goal from the start
Source = Literal["camera", "truth", "taught"]  # of the points in servoing
FeatureSet = Literal[
    "points3d", "points2d", "fourier", "bezier", "bspline", "tangents", "curvature", "turning_angles", "moments", "pca"
]
Size = tuple[int, int]  # (width, height) of an image, in pixels


def run_tasks(work: Callable[..., T], tasks: Iterable[tuple[Any, ...]], jobs: int = 1) -> Iterator[T]:
    """Call ``work(*task)`` for every task, in this process or in several ones, and yield the results as they come."""
    if jobs == 1:
        yield from starmap(work, tasks)
    else:
        from joblib import Parallel, delayed

        workers: Any = Parallel(n_jobs=jobs, return_as="generator_unordered")
        yield from workers(delayed(work)(*task) for task in tasks)
