"""``shape-obs bench envs``: steps per second of the simulated environments."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import tyro
from tqdm import tqdm

from shape_obs.bench.backends import backends
from shape_obs.bench.env_speed import (
    ENVS,
    RENDERERS,
    SIZES,
    WARM_UP,
    Course,
    Env,
    Row,
    speed_claims,
    speed_row,
    speeds,
    stock_row,
)
from shape_obs.bench.env_vectors import vector_row
from shape_obs.bench.interleaved_timing import Clock, machine, no_opengl, opengl
from shape_obs.cli.bench.printing import table

Part = Literal["single", "stock", "vector"]
Renderer = Literal["gl", "rays"]


@dataclass(frozen=True)
class Envs:
    """Steps per second of each environment: without drawing, with images, wrapped, in vectors.

    All ways take turns through the same episodes, on one thread but for the workers of vectors. Rates are those of the
    median step; resets are not counted among the steps and have a column of their own.
    """

    only: tuple[Part, ...] = ()
    """Parts to measure: single environments, these beside MuJoCo's own renderer as it comes, vectors; all if none."""
    envs: tuple[Env, ...] = ENVS
    """Environments."""
    sizes: tuple[str, ...] = tuple(f"{width}x{height}" for width, height in SIZES)
    """Of the images."""
    renderers: tuple[Renderer, ...] = RENDERERS
    """Cameras."""
    steps: int = 200
    """How many are counted."""
    slow_steps: int = 20
    """On how many of them MuJoCo's own renderer draws."""
    seed: int = 0
    """Of episodes and actions."""
    clock: Clock = "wall"
    """Counts the time that passes, or the processor time of the one thread, which a busy machine hardly changes.
    Vectors are always counted in time that passes."""
    burst: int = 10
    """Steps in a turn. With 1 everyone finds the processor's caches full of another's work."""
    json: bool = False
    """Print JSON instead of tables."""


def main(argv: Sequence[str]) -> int:
    """Run the command; returns the exit code."""
    args = tyro.cli(Envs, args=list(argv), prog="shape-obs bench envs")
    for name, value in (("steps", args.steps), ("slow-steps", args.slow_steps), ("burst", args.burst)):
        if value < 1:
            raise ValueError(f"--{name}: expected at least 1, got {value}.")
    document = _measure(args, [_size(text) for text in args.sizes])
    if args.json:
        print(json.dumps(document, indent=2))
    elif document["claims"]:
        print(f"\nasked and seen\n{table(document['claims'])}")
    return 0


def _measure(args: Envs, sizes: list[tuple[int, int]]) -> dict[str, Any]:
    """The parts that are asked for, printed when they are done unless JSON is asked for."""
    away = no_opengl() if "gl" in args.renderers else ""
    renderers = [name for name in args.renderers if name != "gl" or not away]
    document: dict[str, Any] = {
        "measurement": "envs",
        "machine": machine("mujoco", "gymnasium") | {"opengl": opengl() or "none"},
        "steps": args.steps, "seed": args.seed, "clock": args.clock, "burst": args.burst,
        "missing": {"gl": away} if away else {},
    }  # fmt: skip
    if not args.json:
        print("\n".join(f"{name}: {what}" for name, what in document["machine"].items()))
        if away:
            print(f"no OpenGL here, rays alone: {away}")
        if "numba" not in backends():
            print("numba is not installed and left out: pip install shape-obs[fast]")
    wanted: tuple[Part, ...] = args.only or ("single", "stock", "vector")
    slow = args.slow_steps if "stock" in wanted else 0
    courses = [
        Course(env, size, renderer, args.steps, slow, args.seed, args.clock, args.burst)
        for env in args.envs
        for size in sizes
        for renderer in renderers
    ]

    def told(key: str, title: str, rows: list[Row]) -> list[Row]:
        if rows:
            document[key] = rows
            if not args.json:
                print(f"\n{title}\n{table(rows)}")
        return rows

    single: list[Row] = []
    stock: list[Row] = []
    if {"single", "stock"} & {*wanted}:
        alone = [course for course in courses if "single" in wanted or course.renderer == "gl"]
        with _bar("single", alone) as bar:
            for course in alone:
                found = _named(bar, course, speeds)
                single.append(speed_row(course, found))
                if slow and course.renderer == "gl":
                    stock.append(stock_row(course, found))
        single = told("single", "steps per second", single)
        stock = told("stock", "steps per second beside mujoco.Renderer as it comes, OpenGL", stock)
    if "vector" in wanted:
        with _bar("vector", courses) as bar:
            several = [_named(bar, course, vector_row) for course in courses]
        told("vector", "steps per second of two environments together", several)
    document["claims"] = speed_claims(single, stock)
    return document


def _bar(name: str, courses: Sequence[Course]) -> tqdm:
    total = sum(course.steps + WARM_UP for course in courses)
    return tqdm(desc=name, unit="step", total=total, leave=False, file=sys.stderr)


def _named(bar: tqdm, course: Course, run: Callable[..., Any]) -> Any:
    bar.set_postfix_str(f"{course.env} {course.image} {course.renderer}")
    return run(course, bar.update)


def _size(text: str) -> tuple[int, int]:
    width, x, height = text.partition("x")
    if not (x and width.isdigit() and height.isdigit() and 16 <= int(height) <= int(width) <= 4096):
        raise ValueError(
            f"--sizes: expected WIDTHxHEIGHT, 16 to 4096 pixels and no higher than wide, such as 160x120, got {text!r}."
        )
    return int(width), int(height)
