"""``shape-obs bench servo``: compare features and laws that bring a shape to its goal."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from shape_obs.cli.parsing import Option, parse, wrong_usage
from shape_obs.utils.errors import UsageError
from tests.benchmarks import Clock, Difficulty, FeatureSet, ServoEnv, Size, Source
from tests.benchmarks.cli.output import Output, image_size, need_matplotlib, progress

if TYPE_CHECKING:
    from tests.benchmarks.servo.settings import Setting
    from tests.benchmarks.tables import Row


@dataclass(frozen=True)
class Servo:
    """Bring simulated shapes to their goals, the same goals for every combination of features and law.

    Writes episodes.csv, summary.csv, table.md, curves.png and overlays.png, and paired.csv if both sources are named.
    """

    only: Annotated[tuple[Literal["study", "times"], ...], Option(group="measurement")] = ("study",)
    """What to measure: 'study', or 'times' for the time of each feature relative to the detector's."""
    envs: Annotated[tuple[ServoEnv, ...], Option(group="study")] = ("Cable",)
    """Environments."""
    features: Annotated[tuple[FeatureSet, ...], Option(group="study")] = ("points3d", "bspline")
    """Sets of features."""
    laws: Annotated[tuple[str, ...], Option("LAW ...", "study")] = ("mfac", "rls")
    """Control laws, names of shape_obs.servo.LAWS."""
    difficulties: Annotated[tuple[Difficulty, ...], Option(group="study")] = ("near", "middle", "far")
    """Distances of goals from the start."""
    sources: Annotated[tuple[Source, ...], Option(group="study")] = ("camera", "truth")
    """Sources of the points: 'camera', images of a simulated D455; 'truth', the simulator's state; 'taught', images,
    with goals recorded by the camera."""
    sizes: Annotated[tuple[str, ...], Option("WIDTHxHEIGHT ...", "study")] = ("160x120",)
    """Image sizes."""
    goals: Annotated[int, Option("N", "study", least=1)] = 5
    """Number of goals of each combination."""
    steps: Annotated[int, Option("N", "study", least=1)] = 200
    """Number of steps of an episode."""
    seed: Annotated[int, Option("N", "measurement", least=0)] = 0
    """Seed of the first goal; the seeds of the others follow."""
    view: Annotated[Literal["side", "above"] | None, Option(group="study")] = None
    """Where the camera of the hanging rope stands."""
    rope: Annotated[int | None, Option("N", "study", least=0, most=1)] = None
    """Which rope of Cables to bring to its goal, 0 or 1; default 0. Only its gripper moves."""
    invalid: Annotated[float, Option("SHARE", "disturbance", least=0, most=1)] = 0.0
    """Share of the camera's points that are lost, drawn for every frame."""
    blackout: Annotated[tuple[int, int] | None, Option("FIRST COUNT", "disturbance", least=0)] = None
    """First step and number of the camera's black frames."""
    pca: Annotated[Path | None, Option("FILE", "study", existing="file")] = None
    """The file of the features pca, as written by fit-features."""
    paired: Annotated[bool, Option(group="output")] = False
    """Compare camera and truth on the same goals."""
    frames: Annotated[int, Option("N", "timing", least=1)] = 60
    """Number of frames over which the time of features is measured."""
    renderer: Annotated[Literal["auto", "gl", "rays"], Option(group="measurement")] = "auto"
    """The simulator's renderer."""
    clock: Annotated[Clock, Option(group="timing")] = "wall"
    """Clock for the time of features: elapsed time, or the processor time of the thread."""
    jobs: Annotated[int, Option("N", "processing", least=1)] = 1
    """Number of processes, with one thread each."""
    out: Annotated[Path, Option("FOLDER", "output")] = Path("servo")
    """Folder for the results."""
    resume: Annotated[bool, Option(group="output")] = False
    """Keep episodes that the folder already contains, without checking whether the laws have changed."""
    figures: Annotated[bool, Option(group="output")] = True
    """Draw the pictures (needs the extra 'viz')."""
    json: Annotated[bool, Option(group="output")] = False
    """Print JSON instead of tables."""


def main(argv: Sequence[str]) -> int:
    """Run the command and return its exit code: 1 if an episode broke off."""
    args = parse(Servo, argv, "shape-obs bench servo", _check)
    from tests.benchmarks.interleaved_timing import machine

    settings = _settings(args)
    output = Output(args.json, measurement="servo", machine=machine("mujoco", "gymnasium"), seed=args.seed)
    broken = _study(args, settings, output) if "study" in args.only else 0
    if "times" in args.only:
        _times(args, output)
    output.close()
    return 1 if broken else 0


def _check(args: Servo) -> None:
    """Reject options that do not go together, before a measurement is imported."""
    if args.paired and not {"camera", "truth"} <= set(args.sources):
        raise UsageError(f"--paired: needs --sources camera truth, got {' '.join(args.sources)}.")
    if args.view is not None and set(args.envs) != {"Hanging"}:
        raise UsageError(f"--view: only Hanging has views, got --envs {' '.join(args.envs)}.")
    if args.rope is not None and set(args.envs) != {"Cables"}:
        raise UsageError(f"--rope: only Cables has ropes, got --envs {' '.join(args.envs)}.")
    if args.blackout is not None and sum(args.blackout) > args.steps:
        raise UsageError(f"--blackout: {args.blackout[1]} frames from {args.blackout[0]} on end after --steps.")
    for size in args.sizes:
        image_size(size, 16)


def _settings(args: Servo) -> list[Setting]:
    """Return the settings of the study; every mistake in the options is reported before anything runs."""
    from shape_obs.servo import LAWS
    from shape_obs.spec import did_you_mean
    from tests.benchmarks.servo.settings import Disturbance, combinations, missing

    for law in args.laws:
        if law not in LAWS:
            raise UsageError(f"--laws: unknown law {law!r}{did_you_mean(law, LAWS)}")
    wrong = Disturbance(args.invalid, args.blackout)
    with wrong_usage():
        wrong.check()
    if "study" in args.only and args.figures:
        need_matplotlib()
    pca = None if args.pca is None else str(args.pca.resolve())
    with wrong_usage():
        found = combinations(
            args.envs, args.features, args.laws, args.difficulties, args.sources, args.sizes, wrong, args.renderer, pca
        )
        found = [each._replace(view=args.view, rope=args.rope) for each in found]
    settings, without = list(dict.fromkeys(found)), ", ".join(missing(args.envs, args.features))
    if without and not args.json:
        print(f"there are no {without}: left out")
    if not settings and "study" in args.only:
        raise UsageError(f"--features: there are no {without}.")
    return settings


def _study(args: Servo, settings: Sequence[Setting], output: Output) -> int:
    """Play all episodes, write and print the results, and return the number of episodes that broke off."""
    from tests.benchmarks.servo.pictures import draw
    from tests.benchmarks.servo.study import paired_rows, run, summary_rows, without_empty, write_tables

    broken: list[str] = []
    seeds = range(args.seed, args.seed + args.goals)
    with progress("servo", "episode", len(settings) * len(seeds)) as bar:

        def tick(setting: Setting, episode: Row) -> None:
            bar.set_postfix_str(setting.name, refresh=False)
            bar.update()
            if episode.failure:
                broken.append(f"{setting.name}, seed {episode.seed}: {episode.failure}")
                bar.write(f"broke off: {broken[-1]}", file=sys.stderr)

        found = run(settings, seeds, steps=args.steps, jobs=args.jobs, folder=args.out, resume=args.resume, tick=tick)
    write_tables(found, args.out)
    if args.figures:
        draw(found, args.out)
    rows, pairs = summary_rows(found), paired_rows(found) if args.paired else []
    output.document |= {"goals": args.goals, "steps": args.steps, "summary": rows, "broken": broken}
    output.table("success in percent of goals, millimetres from them", without_empty(rows), "")
    if args.paired:
        output.document["paired"] = pairs
        output.table("the camera and the true points", without_empty(pairs), "")
    output.note(f"\nwritten to {args.out}")
    return len(broken)


def _times(args: Servo, output: Output) -> None:
    from tests.benchmarks.interleaved_timing import Timing
    from tests.benchmarks.servo.times import WARM_UP, feature_times, targets

    sizes: list[tuple[ServoEnv, Size]] = [(env, image_size(size, 16)) for env in args.envs for size in args.sizes]
    rows = []
    with progress("times", "frame", len(sizes) * (args.frames + WARM_UP)) as bar:
        timing = Timing(args.seed, args.clock, tick=bar.update)
        for env, size in sizes:
            rows += feature_times(env, size, args.frames, timing, args.renderer)
    output.table("features and the detector", rows, "times")
    output.claims(targets(rows))
