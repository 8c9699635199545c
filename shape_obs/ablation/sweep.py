"""All runs of a study: what is done is left alone, what was interrupted begins anew from its seed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from shape_obs.ablation.engines import Engine
from shape_obs.ablation.folder import RunFolder, done_runs
from shape_obs.ablation.study import Study
from shape_obs.ablation.work import Outcome, Task

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
