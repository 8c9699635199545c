"""``shape-obs bench servo``: which features and laws bring a shape to its goal, from the camera and from the truth."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro
from tqdm import tqdm

from shape_obs.bench.env_speed import Env
from shape_obs.bench.interleaved_timing import Clock, machine
from shape_obs.bench.servo.episode import Episode
from shape_obs.bench.servo.pictures import draw, need_matplotlib
from shape_obs.bench.servo.settings import (
    DIFFICULTIES,
    SOURCES,
    Difficulty,
    Disturbance,
    FeatureSet,
    Setting,
    Source,
    combinations,
    image_size,
    missing,
)
from shape_obs.bench.servo.study import lean, run, write_tables
from shape_obs.bench.servo.summary import paired_rows, summary_rows
from shape_obs.bench.servo.times import WARM_UP, asked_rows, feature_times
from shape_obs.cli.bench.printing import table
from shape_obs.servo import LAWS
from shape_obs.spec import did_you_mean

_LEAST = 16  # pixels


@dataclass(frozen=True)
class Servo:
    """Shape servoing: for every combination of features and law so many goals, the same ones for all.

    Writes episodes.csv, summary.csv, table.md, curves.png and overlays.png, and paired.csv where both sources are
    named.
    """

    only: tuple[Literal["study", "times"], ...] = ("study",)
    """What is measured: the study; the time of each feature beside the detector's."""
    envs: tuple[Env, ...] = ("Cable",)
    """Environments."""
    features: tuple[FeatureSet, ...] = ("points3d", "bspline")
    """Sets of features."""
    laws: tuple[str, ...] = ("mfac", "rls")
    """Names of shape_obs.servo.LAWS."""
    difficulties: tuple[Difficulty, ...] = DIFFICULTIES
    """How far goals are from the start."""
    sources: tuple[Source, ...] = SOURCES
    """Where the points come from: the images of a simulated D455; the simulator's state; the images, for points and for
    the goal."""
    sizes: tuple[str, ...] = ("160x120",)
    """Of the images."""
    goals: int = 5
    """For each combination."""
    steps: int = 200
    """Of an episode."""
    seed: int = 0
    """Of the first goal; the others count on."""
    invalid: float = 0.0
    """Share of the camera's points that are lost, drawn anew in every frame."""
    blackout: tuple[int, int] | None = None
    """First step of the camera's black frames, and how many there are."""
    pca: Path | None = None
    """The file of the features pca, as fit-features writes it."""
    paired: bool = False
    """Print the camera beside the truth, on the same goals."""
    frames: int = 60
    """Over which the time of features is measured."""
    renderer: Literal["auto", "gl", "rays"] = "auto"
    """The simulator's camera."""
    clock: Clock = "wall"
    """Counts the time that passes, or the processor time of the one thread, for the time of features."""
    jobs: int = 1
    """Processes, of one thread each."""
    out: Path = Path("servo")
    """Folder for the results."""
    resume: bool = False
    """Take from the folder the episodes that it holds already. The laws must be the same: it is not checked."""
    figures: bool = True
    """Draw the pictures; they need the extra viz."""
    json: bool = False
    """Print JSON instead of tables."""


def main(argv: Sequence[str]) -> int:
    """Run the command; returns the exit code: 1 if an episode broke off."""
    args = tyro.cli(Servo, args=list(argv), prog="shape-obs bench servo")
    settings = _settings(args)
    document: dict[str, Any] = {"measurement": "servo", "machine": machine("mujoco", "gymnasium"), "seed": args.seed}
    broken = 0
    if "study" in args.only:
        broken = _study(args, settings, document)
    if "times" in args.only:
        _times(args, document)
    if args.json:
        print(json.dumps(document, indent=2))
    return 1 if broken else 0


def _settings(args: Servo) -> list[Setting]:
    """What is to be played; every mistake is told before anything runs."""
    for name, least in (("goals", 1), ("steps", 1), ("seed", 0), ("frames", 1), ("jobs", 1)):
        if getattr(args, name) < least:
            raise ValueError(f"--{name}: expected at least {least}, got {getattr(args, name)}.")
    for law in args.laws:
        if law not in LAWS:
            raise ValueError(f"--laws: unknown law {law!r}{did_you_mean(law, LAWS)}")
    if args.pca is not None and not args.pca.is_file():
        raise FileNotFoundError(f"{args.pca}: no such file")
    if args.paired and not set(SOURCES) <= set(args.sources):
        raise ValueError(f"--paired: needs --sources camera truth, got {' '.join(args.sources)}.")
    wrong = Disturbance(args.invalid, args.blackout)
    wrong.check()
    if wrong.blackout is not None and sum(wrong.blackout) > args.steps:
        raise ValueError(f"--blackout: {wrong.blackout[1]} frames from {wrong.blackout[0]} on end after --steps.")
    if "study" in args.only and args.figures:
        need_matplotlib()
    found = combinations(
        args.envs, args.features, args.laws, args.difficulties, args.sources, args.sizes, wrong, args.renderer,
        None if args.pca is None else str(args.pca.resolve()),
    )  # fmt: skip
    settings = list(dict.fromkeys(found))
    for size in args.sizes:
        width, height = image_size(size)
        if not _LEAST <= height <= width:
            raise ValueError(f"--sizes: expected {_LEAST} pixels or more, no higher than wide, got {size}.")
    without = missing(args.envs, args.features)
    if without and not args.json:
        print(f"there are no {', '.join(without)}: left out")
    if not settings and "study" in args.only:
        raise ValueError(f"--features: there are no {', '.join(without)}.")
    return settings


def _study(args: Servo, settings: Sequence[Setting], document: dict[str, Any]) -> int:
    """Play all episodes, write the results and print them; returns how many broke off."""
    broken: list[str] = []
    seeds = range(args.seed, args.seed + args.goals)
    with tqdm(desc="servo", unit="episode", total=len(settings) * len(seeds), leave=False, file=sys.stderr) as bar:

        def tick(setting: Setting, episode: Episode) -> None:
            bar.set_postfix_str(setting.name, refresh=False)
            bar.update()
            if episode.failure:
                broken.append(f"{setting.name}, seed {episode.seed}: {episode.failure}")
                bar.write(f"broke off: {broken[-1]}", file=sys.stderr)

        found = run(settings, seeds, steps=args.steps, jobs=args.jobs, folder=args.out, resume=args.resume, tick=tick)
    write_tables(found, args.out)
    if args.figures:
        draw(found, args.out)
    rows = summary_rows(found)
    document |= {"goals": args.goals, "steps": args.steps, "summary": rows, "broken": broken}
    pairs = paired_rows(found) if args.paired else []
    if args.paired:
        document["paired"] = pairs
    if not args.json:
        print(f"\nsuccess in percent of goals, millimetres from them\n{table(lean(rows))}")
        if pairs:
            print(f"\nthe camera beside the true points\n{table(lean(pairs))}")
        print(f"\nwritten to {args.out}")
    return len(broken)


def _times(args: Servo, document: dict[str, Any]) -> None:
    sizes: list[tuple[Env, tuple[int, int]]] = [(env, image_size(size)) for env in args.envs for size in args.sizes]
    rows: list[dict[str, Any]] = []
    total = len(sizes) * (args.frames + WARM_UP)
    with tqdm(desc="times", unit="frame", total=total, leave=False, file=sys.stderr) as bar:
        for env, size in sizes:
            rows += feature_times(
                env, size, args.frames, seed=args.seed, renderer=args.renderer, clock=args.clock,
                tick=bar.update,
            )  # fmt: skip
    document |= {"times": rows, "claims": asked_rows(rows)}
    if not args.json:
        print(f"\nfeatures beside the detector on NumPy\n{table(rows)}")
        print(f"\nasked and seen\n{table(document['claims'])}")
