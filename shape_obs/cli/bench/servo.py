"""``shape-obs bench servo``: compare features and laws that bring a shape to its goal."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from shape_obs.bench import Clock, Difficulty, FeatureSet, ServoEnv, Size, Source
from shape_obs.cli.bench.output import Output, check_minimum, image_size, need_matplotlib, progress

if TYPE_CHECKING:
    from shape_obs.bench.servo.settings import Setting
    from shape_obs.bench.tables import Row


@dataclass(frozen=True)
class Servo:
    """Servo shapes: the same goals for every combination of features and law.

    Writes episodes.csv, summary.csv, table.md, curves.png and overlays.png, and paired.csv if both sources are named.
    """

    only: tuple[Literal["study", "times"], ...] = ("study",)
    """What to measure: the study; the time of each feature relative to the detector's."""
    envs: tuple[ServoEnv, ...] = ("Cable",)
    """Environments."""
    features: tuple[FeatureSet, ...] = ("points3d", "bspline")
    """Sets of features."""
    laws: tuple[str, ...] = ("mfac", "rls")
    """Names of shape_obs.servo.LAWS."""
    difficulties: tuple[Difficulty, ...] = ("near", "middle", "far")
    """Distances of goals from the start."""
    sources: tuple[Source, ...] = ("camera", "truth")
    """Sources of the points: the images of a simulated D455; the simulator's state; the images for points and goal."""
    sizes: tuple[str, ...] = ("160x120",)
    """Image sizes."""
    goals: int = 5
    """Goals of each combination."""
    steps: int = 200
    """Steps of an episode."""
    seed: int = 0
    """Seed of the first goal; the seeds of the others follow."""
    view: Literal["side", "above"] | None = None
    """Where the camera of the hanging rope stands."""
    rope: int | None = None
    """Which rope of Cables is brought to its goal, 0 or 1; default 0. Only its gripper moves."""
    invalid: float = 0.0
    """Share of the camera's points that are lost, drawn again in every frame."""
    blackout: tuple[int, int] | None = None
    """First step of the camera's black frames, and their number."""
    pca: Path | None = None
    """The file of the features pca, as written by fit-features."""
    paired: bool = False
    """Print the camera next to the truth, on the same goals."""
    frames: int = 60
    """Frames over which the time of features is measured."""
    renderer: Literal["auto", "gl", "rays"] = "auto"
    """The simulator's renderer."""
    clock: Clock = "wall"
    """Clock for the time of features: elapsed time, or the processor time of the thread."""
    jobs: int = 1
    """Processes of one thread each."""
    out: Path = Path("servo")
    """Folder for the results."""
    resume: bool = False
    """Keep the episodes that the folder holds already. It is not checked whether the laws have changed."""
    figures: bool = True
    """Draw the pictures; they need the extra viz."""
    json: bool = False
    """Print JSON instead of tables."""


def main(argv: Sequence[str]) -> int:
    """Run the command and return its exit code: 1 if an episode broke off."""
    args = tyro.cli(Servo, args=list(argv), prog="shape-obs bench servo")
    from shape_obs.bench.interleaved_timing import machine

    settings = _settings(args)
    output = Output(args.json, measurement="servo", machine=machine("mujoco", "gymnasium"), seed=args.seed)
    broken = _study(args, settings, output) if "study" in args.only else 0
    if "times" in args.only:
        _times(args, output)
    output.close()
    return 1 if broken else 0


def _settings(args: Servo) -> list[Setting]:
    """Return the settings of the study; every mistake in the options is reported before anything runs."""
    from shape_obs.bench.servo.settings import Disturbance, combinations, missing
    from shape_obs.servo import LAWS
    from shape_obs.spec import did_you_mean

    check_minimum(args, goals=1, steps=1, seed=0, frames=1, jobs=1)
    for law in args.laws:
        if law not in LAWS:
            raise ValueError(f"--laws: unknown law {law!r}{did_you_mean(law, LAWS)}")
    if args.pca is not None and not args.pca.is_file():
        raise FileNotFoundError(f"{args.pca}: no such file")
    if args.paired and not {"camera", "truth"} <= set(args.sources):
        raise ValueError(f"--paired: needs --sources camera truth, got {' '.join(args.sources)}.")
    if args.view is not None and set(args.envs) != {"Hanging"}:
        raise ValueError(f"--view: only Hanging has views, got --envs {' '.join(args.envs)}.")
    if args.rope is not None and (set(args.envs) != {"Cables"} or args.rope not in (0, 1)):
        raise ValueError(
            f"--rope: 0 or 1, and only Cables has ropes, got {args.rope} and --envs {' '.join(args.envs)}."
        )
    wrong = Disturbance(args.invalid, args.blackout)
    wrong.check()
    if wrong.blackout is not None and sum(wrong.blackout) > args.steps:
        raise ValueError(f"--blackout: {wrong.blackout[1]} frames from {wrong.blackout[0]} on end after --steps.")
    if "study" in args.only and args.figures:
        need_matplotlib()
    for size in args.sizes:
        image_size(size, 16)
    pca = None if args.pca is None else str(args.pca.resolve())
    found = combinations(
        args.envs, args.features, args.laws, args.difficulties, args.sources, args.sizes, wrong, args.renderer, pca
    )
    found = [each._replace(view=args.view, rope=args.rope) for each in found]
    settings, without = list(dict.fromkeys(found)), ", ".join(missing(args.envs, args.features))
    if without and not args.json:
        print(f"there are no {without}: left out")
    if not settings and "study" in args.only:
        raise ValueError(f"--features: there are no {without}.")
    return settings


def _study(args: Servo, settings: Sequence[Setting], output: Output) -> int:
    """Play all episodes, write and print the results, and return the number of episodes that broke off."""
    from shape_obs.bench.servo.pictures import draw
    from shape_obs.bench.servo.study import paired_rows, run, summary_rows, without_empty, write_tables

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
    from shape_obs.bench.interleaved_timing import Timing
    from shape_obs.bench.servo.times import WARM_UP, feature_times, targets

    sizes: list[tuple[ServoEnv, Size]] = [(env, image_size(size, 16)) for env in args.envs for size in args.sizes]
    rows = []
    with progress("times", "frame", len(sizes) * (args.frames + WARM_UP)) as bar:
        timing = Timing(args.seed, args.clock, tick=bar.update)
        for env, size in sizes:
            rows += feature_times(env, size, args.frames, timing, args.renderer)
    output.table("features and the detector", rows, "times")
    output.claims(targets(rows))
