"""``shape-obs ablate``: repeat a training with different observations, and compare the results."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from shape_obs.cli.options import warnings_as_lines
from shape_obs.cli.outputs import Overwrite, check_outputs, note_output
from shape_obs.cli.parsing import Option, parse
from shape_obs.utils.errors import UsageError, did_you_mean

if TYPE_CHECKING:
    from tqdm import tqdm

    from shape_obs.ablation import Study
    from shape_obs.ablation.executors import Engine, Outcome
    from shape_obs.ablation.results import FinishedRun


@dataclass(frozen=True)
class Arguments:
    """Train every arm of a study with every seed, and compare the errors of the true points in millimetres.

    When the command runs again, finished runs are kept and interrupted ones restart from their seed. The exit code is 1
    if a run failed.
    """

    config: Annotated[Path, Option("STUDY", positional=True, existing="file of a study")]
    """A YAML file that describes the study."""
    out: Annotated[Path, Option("FOLDER", "output", "-o")]
    """Folder for the runs and the results."""
    jobs: Annotated[int | None, Option("N", "processing", least=1)] = None
    """Number of parallel runs, default 1; with Ray, number of cores of the cluster started on this machine."""
    engine: Annotated[Literal["local", "ray"], Option(group="processing")] = "local"
    """Run in processes of this machine, or on a Ray cluster."""
    address: Annotated[str | None, Option("ADDRESS", "processing")] = None
    """Address of a Ray cluster: auto or ray://HOST:10001; default: start one on this machine."""
    only: Annotated[tuple[str, ...], Option("ARM ...", "study")] = ()
    """Run only these arms."""
    seeds: Annotated[tuple[int, ...], Option("N ...", "study", least=0)] = ()
    """Seeds; replaces those of the config."""
    table_only: Annotated[bool, Option(group="output")] = False
    """Run nothing; make the table and the pictures from finished runs."""
    overwrite: Overwrite = False
    """Replace existing tables and pictures; unchanged ones of earlier runs are replaced in any case."""
    json: Annotated[bool, Option(group="output")] = False
    """Print the summary as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the command and return the exit code."""
    args = parse(Arguments, argv, "shape-obs ablate")
    if args.address is not None and args.engine != "ray":
        raise UsageError("--address: only for a Ray cluster; give --engine ray too.")
    from shape_obs.ablation import load_study
    from shape_obs.ablation.report import CURVES, DEGRADATION, INTERVALS, TABLE, need_matplotlib
    from shape_obs.ablation.results import RESULTS
    from shape_obs.utils.files import make_folder

    check_outputs(args, *(args.out / name for name in (RESULTS, TABLE, CURVES, INTERVALS, DEGRADATION)))
    need_matplotlib()
    study = load_study(args.config)
    for name in args.only:
        if name not in study.arms:
            raise UsageError(f"--only: {args.config} has no arm {name!r}{did_you_mean(name, study.arms)}")
    if min(args.seeds, default=0) < 0 or max(args.seeds, default=0) >= study.evaluation.seed:
        raise UsageError(f"--seeds: expected 0 ... {study.evaluation.seed - 1}, got {list(args.seeds)}.")
    make_folder(args.out)
    failed = [] if args.table_only else _run(args, study)
    result = _results(args, study)
    print(json.dumps(result) if args.json else _text(result))
    for outcome in failed:
        last = outcome.error.strip().splitlines()[-1]
        print(f"shape-obs ablate: {outcome.task.name} failed: {last}", file=sys.stderr)
    return 1 if failed else 0


def _run(args: Arguments, study: Study) -> list[Outcome]:
    """Run what is not finished yet, and return the failed runs."""
    from tqdm import tqdm

    from shape_obs.ablation.sweep import check, left, sweep

    folders = left(study, args.out, list(dict.fromkeys(args.only)), list(dict.fromkeys(args.seeds)))
    if not folders:
        return []
    with warnings_as_lines("shape-obs ablate"):
        check(study, list(dict.fromkeys(folder.arm for folder in folders)))
        engine = _engine(args)
        with tqdm(total=len(folders) * study.steps, unit="step", unit_scale=True, desc="training") as bar:
            outcomes = sweep(study, folders, engine, _progress(bar, len(folders)))
    return [outcome for outcome in outcomes if outcome.error]


def _engine(args: Arguments) -> Engine:
    from shape_obs.ablation.executors import Local, Ray

    if args.engine == "ray":
        return Ray(args.address, args.jobs)
    return Local(1 if args.jobs is None else args.jobs)


def _progress(bar: tqdm, runs: int) -> Callable[[int, Sequence[Outcome]], None]:
    def show(steps: int, ended: Sequence[Outcome]) -> None:
        failed = sum(bool(outcome.error) for outcome in ended)
        bar.set_postfix_str(f"{len(ended)} of {runs} runs" + (f", {failed} failed" if failed else ""), refresh=False)
        bar.update(steps - bar.n)

    return show


def _results(args: Arguments, study: Study) -> dict[str, Any]:
    """Write table and pictures of the finished runs; return the results and the files."""
    from shape_obs.ablation.report import draw, markdown, summary_to_dict, write_table
    from shape_obs.ablation.results import finished_runs, write_results
    from shape_obs.ablation.statistics import summarize

    runs = finished_runs(study, args.out)
    if not runs:
        raise ValueError(f"{args.out}: no run of this study is finished.")
    summary = summarize(study, runs)
    files = [write_results(runs, args.out), write_table(study, summary, args.out), *draw(study, summary, args.out)]
    for path in files:
        note_output(path)
    result = {"arms": summary_to_dict(summary), "table": markdown(study, summary), "files": list(map(str, files))}
    return result if args.table_only else {**result, **_best_policy(args, study, runs)}


def _best_policy(args: Arguments, study: Study, runs: Sequence[FinishedRun]) -> dict[str, str]:
    """Return the file of the best policy and the command that runs it on the simulated robot.

    The best has the smallest final distance from the goals, as the mean of its last evaluation. Policies that can run
    with a camera come first; if there is none, ``"next"`` is the reason.
    """
    from shape_obs.ablation.executors import POLICY
    from shape_obs.ablation.results import RunFolder
    from shape_obs.policy import PolicyError, deploy_command

    def error(run: FinishedRun) -> float:
        difficulties = study.evaluation.difficulties
        return sum(run.final_mm(difficulty) for difficulty in difficulties) / len(difficulties)

    best: dict[str, str] = {}
    for run in sorted(runs, key=error):
        path = RunFolder(args.out, run.arm, run.seed).path / POLICY
        try:
            return {"policy": str(path), "next": deploy_command(path)}
        except PolicyError as problem:  # it reads the simulator's state
            best = best or {"policy": str(path), "next": f"it is for simulation only: {problem}"}
        except FileNotFoundError:  # removed by the user
            continue
    return best


def _text(result: dict[str, Any]) -> str:
    lines = [result["table"], "", *(f"wrote {path}" for path in result["files"])]
    if "policy" in result:
        lines += [f"best policy: {result['policy']}", f"next: {result['next']}"]
    return "\n".join(lines)
