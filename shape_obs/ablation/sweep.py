"""What is wrong with a study, told before anything runs.

All runs of a study: what is done is left alone, what was interrupted begins anew from its seed.
"""

from __future__ import annotations
from collections.abc import Callable, Sequence
from typing import Any
from shape_obs.ablation.study import Arm
from shape_obs.ablation.study import make_env
from shape_obs.ablation.training_run import make_model
from shape_obs.ablation.training_run import training_env
from shape_obs.ablation.study import Study
from pathlib import Path
from shape_obs.ablation.executors import Engine
from shape_obs.ablation.results import RunFolder
from shape_obs.ablation.results import done_runs
from shape_obs.ablation.executors import Outcome
from shape_obs.ablation.executors import Task



def check(study: Study, arms: Sequence[str] | None = None) -> None:
    """Make every environment and every learner of a study once.

    Args:
        study: What is to be compared.
        arms: Only these.

    Raises:
        ValueError: What is wrong, of all arms.
        ImportError: The extra ``sim`` or ``sb3`` is missing.
    """
    wrong = [
        f"arms.{name}: {complaint}"
        for name in arms or study.arms
        for complaint in [_complaint(lambda name=name: _try(study, study.arms[name]))]
        if complaint
    ]
    if wrong:
        raise ValueError("; ".join(dict.fromkeys(wrong)))



def _try(study: Study, arm: Arm) -> None:
    env = training_env(study, arm, 0)
    try:
        model: Any = make_model(study, arm, env, 0)
        if study.her is not None and model.learning_starts < study.episode:
            raise ValueError(
                f"hyperparameters.learning_starts: hindsight needs a whole episode, {study.episode} steps, "
                f"got {model.learning_starts}."
            )
        env.reset()
    finally:
        env.close()
    plan = study.evaluation
    tried = [None, *([] if arm.observation == "truth" else plan.disturbances.values())]
    for disturbance in tried:
        trial = make_env(arm, study.env, {"reward_type": "sparse", **study.env_arguments}, study.episode, disturbance)
        try:
            simulator: Any = trial.unwrapped
            for difficulty in plan.difficulties:
                simulator.difficulty = difficulty
                _, info = trial.reset(seed=plan.seed)
                if "truth/mean_error" not in info:
                    raise ValueError(f"env: {study.env} does not tell the true error, info['truth/mean_error'].")
        finally:
            trial.close()



def _complaint(attempt: Callable[[], object]) -> str:
    """What it raises; empty where it does not."""
    try:
        attempt()
    except ImportError:
        raise
    except Exception as error:  # noqa: BLE001  learners and environments raise whatever they like
        return f"{type(error).__name__}: {error}" if not isinstance(error, ValueError) else str(error)
    return ""



#: Called with the steps that all runs have done so far, and the outcomes so far.
Told = Callable[[int, Sequence[Outcome]], object]



def left(
    study: Study, root: Path, arms: Sequence[str] | None = None, seeds: Sequence[int] | None = None
) -> list[RunFolder]:
    """The runs of a study that are not done yet.

    Args:
        study: What is compared.
        root: Its folder; the runs have folders in it.
        arms: Only these.
        seeds: These instead of the study's.

    Raises:
        ValueError: The folder holds runs of another configuration; what differs is named.
    """
    done = set(done_runs(study, root))
    wanted = [RunFolder(root, arm, seed) for arm in arms or study.arms for seed in seeds or study.seeds]
    return [folder for folder in wanted if folder not in done]



def sweep(
    study: Study, folders: Sequence[RunFolder], engine: Engine, told: Told = lambda steps, ended: None
) -> list[Outcome]:
    """Do runs of a study, each from its seed.

    A run that fails loses only itself: its folder tells why.

    Args:
        study: What is compared.
        folders: Of the runs; what an earlier try left in them is removed.
        engine: Where runs are done.
        told: Called about twice a second.

    Returns:
        What became of each run, in the order in which they ended.
    """
    of = {f"{folder.arm}/seed{folder.seed}": folder for folder in folders}
    tasks = [Task(study, folder.arm, folder.seed, folder.path.absolute()) for folder in folders]
    ended: dict[str, Outcome] = {}

    def tell() -> None:
        under_way = sum(folder.steps() for name, folder in of.items() if name not in ended)
        told(len(ended) * study.steps + under_way, list(ended.values()))

    for folder in folders:
        folder.begin()
    for outcome in engine(tasks, tell):
        of[outcome.task.name].keep(outcome)
        ended[outcome.task.name] = outcome
        tell()
    return list(ended.values())

