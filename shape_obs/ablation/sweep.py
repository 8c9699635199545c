"""Check a study, and do its runs: finished runs are skipped, interrupted ones restart from their seed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from shape_obs.ablation.executors import Engine, Outcome, Task
from shape_obs.ablation.results import RunFolder, done_runs
from shape_obs.ablation.study import Arm, Study
from shape_obs.ablation.training_run import make_env, make_model, training_env

#: Called with the number of steps of all runs so far, and the outcomes so far.
Progress = Callable[[int, Sequence[Outcome]], object]


def left(
    study: Study, root: Path, arms: Sequence[str] | None = None, seeds: Sequence[int] | None = None
) -> list[RunFolder]:
    """Return the runs of a study that are not finished.

    Args:
        study: The study.
        root: Its folder, which contains the folders of the runs.
        arms: Names of the arms; default all.
        seeds: Seeds; default those of the study.

    Raises:
        ValueError: The folder holds runs of another configuration; the message names the differences.
    """
    done = set(done_runs(study, root))
    wanted = [RunFolder(root, arm, seed) for arm in arms or study.arms for seed in seeds or study.seeds]
    return [folder for folder in wanted if folder not in done]


def sweep(
    study: Study, folders: Sequence[RunFolder], engine: Engine, progress: Progress = lambda steps, ended: None
) -> list[Outcome]:
    """Do runs of a study, each from its seed.

    A run that fails does not affect the others; its folder gets ``error.txt``.

    Args:
        study: The study.
        folders: Folders of the runs; files of interrupted runs in them are removed.
        engine: Does the runs.
        progress: Called about twice a second.

    Returns:
        The outcome of each run, in the order in which they ended.
    """
    by_name = {f"{folder.arm}/seed{folder.seed}": folder for folder in folders}
    tasks = [Task(study, folder.arm, folder.seed, folder.path.absolute()) for folder in folders]
    ended: dict[str, Outcome] = {}

    def report() -> None:
        in_progress = sum(folder.steps() for name, folder in by_name.items() if name not in ended)
        progress(len(ended) * study.steps + in_progress, list(ended.values()))

    for folder in folders:
        folder.clear()
    for outcome in engine(tasks, report):
        by_name[outcome.task.name].save(outcome)
        ended[outcome.task.name] = outcome
        report()
    return list(ended.values())


def check(study: Study, arms: Sequence[str] | None = None) -> None:
    """Check a study before anything runs, by making every environment and every model once.

    Args:
        study: The study.
        arms: Names of the arms to check; default all.

    Raises:
        ValueError: The message lists the errors of all arms.
        ImportError: The extra ``sim`` or ``sb3`` is missing.
    """
    errors = [
        f"arms.{name}: {message}"
        for name in arms or study.arms
        for message in [_error_of(lambda name=name: _make_once(study, study.arms[name]))]
        if message
    ]
    if errors:
        raise ValueError("; ".join(dict.fromkeys(errors)))


def _make_once(study: Study, arm: Arm) -> None:
    env = training_env(study, arm, 0)
    try:
        model: Any = make_model(study, arm, env, 0)
        if study.her is not None and model.learning_starts < study.episode:
            raise ValueError(
                f"hyperparameters.learning_starts: hindsight replay needs a whole episode, {study.episode} steps, "
                f"got {model.learning_starts}."
            )
        env.reset()
    finally:
        env.close()
    plan = study.evaluation
    disturbances = [None, *([] if arm.observation == "truth" else plan.disturbances.values())]
    for disturbance in disturbances:
        trial = make_env(arm, study.env, {"reward_type": "sparse", **study.env_arguments}, study.episode, disturbance)
        try:
            simulator: Any = trial.unwrapped
            for difficulty in plan.difficulties:
                simulator.difficulty = difficulty
                _, info = trial.reset(seed=plan.seed)
                if "truth/mean_error" not in info:
                    raise ValueError(f"env: {study.env} does not provide the true error, info['truth/mean_error'].")
        finally:
            trial.close()


def _error_of(attempt: Callable[[], object]) -> str:
    """Return the message of the exception that a call raises; ``""`` if it raises none."""
    try:
        attempt()
    except ImportError:
        raise
    except Exception as error:  # noqa: BLE001  models and environments raise any exception
        return f"{type(error).__name__}: {error}" if not isinstance(error, ValueError) else str(error)
    return ""
