"""``shape-obs bench latency``, ``peers`` and ``envs``: measure speed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, get_args

from shape_obs.cli.parsing import Option, parse
from tests.benchmarks import ENVS, Clock, Env
from tests.benchmarks.cli.output import Output, image_size, progress

if TYPE_CHECKING:
    from tqdm import tqdm

    from tests.benchmarks.interleaved_timing import Timing

Work = Literal["rope", "contour", "cloth"]


@dataclass(frozen=True)
class _TimingOptions:
    seed: Annotated[int, Option("N", "measurement", least=0)] = 0
    """Random seed."""
    clock: Annotated[Clock, Option(group="timing")] = "wall"
    """Clock: elapsed time, or the processor time of the thread, which hardly depends on other load."""
    burst: Annotated[int, Option("N", "timing", least=1)] = 10
    """Consecutive frames or steps of a method; with 1, each method runs with CPU caches filled by another one."""
    json: Annotated[bool, Option(group="output")] = False
    """Print JSON instead of tables."""


@dataclass(frozen=True)
class Latency(_TimingOptions):
    """Time every stage from an RGB-D image to 20 points in space, warm and cold, and how the time grows.

    One pass over the same image and the usual segmentation are timed with it. All methods take turns on every frame, on
    one thread.
    """

    only: Annotated[tuple[Literal["stages", "growth"], ...], Option(group="measurement")] = ("stages", "growth")
    """Parts to measure: the stages at every image size; the growth with pixels, points and shapes."""
    frames: Annotated[int, Option("N", "measurement", least=1)] = 60
    """Number of counted frames."""
    sizes: Annotated[tuple[str, ...], Option("WIDTHxHEIGHT ...", "measurement")] = (
        "320x240",
        "640x480",
        "848x480",
        "1280x720",
        "1280x800",
    )
    """Image sizes."""
    memory: Annotated[int, Option("N", "measurement", least=0)] = 0
    """Number of frames over which the growth of the process's memory is measured; 0 skips it."""


@dataclass(frozen=True)
class Peers(_TimingOptions):
    """Compare the detector with other methods: same masks, same number of points, in turns, on one thread.

    Timing starts when the mask, or the mask's pixels as floats, are ready. The times of clusterers include neither the
    selection of the pixels nor the order of the points, which clusterers do not provide.
    """

    only: Annotated[tuple[Work, ...], Option(group="measurement")] = get_args(Work)
    """Tasks to measure."""
    frames: Annotated[int, Option("N", "measurement", least=1)] = 100
    """Number of counted frames."""
    slow_frames: Annotated[int, Option("N", "measurement", least=0)] = 5
    """Number of frames on which slow methods run (K-means with ten starts, mixture, fuzzy); 0 skips these methods."""


@dataclass(frozen=True)
class Envs(_TimingOptions):
    """Count the steps per second of each environment: without rendering, with images, and wrapped.

    All variants take turns through the same episodes, on one thread. Rates are those of the median step; resets have a
    separate column.
    """

    envs: Annotated[tuple[Env, ...], Option(group="measurement")] = ENVS
    """Environments."""
    sizes: Annotated[tuple[str, ...], Option("WIDTHxHEIGHT ...", "measurement")] = ("84x84", "160x120", "640x480")
    """Image sizes."""
    renderers: Annotated[tuple[Literal["gl", "rays"], ...], Option(group="measurement")] = ("gl", "rays")
    """Renderers; without OpenGL only rays are measured."""
    steps: Annotated[int, Option("N", "measurement", least=1)] = 200
    """Number of counted steps."""


def main(name: str, argv: Sequence[str]) -> int:
    """Run one of the commands and return its exit code."""
    options, run = _COMMANDS[name]
    args = parse(options, argv, f"shape-obs bench {name}")
    run(args).close()
    return 0


def _output(name: str, args: Any, *packages: str) -> Output:
    from tests.benchmarks.interleaved_timing import machine

    run = {key: getattr(args, key) for key in ("frames", "steps", "seed", "clock", "burst") if hasattr(args, key)}
    return Output(args.json, measurement=name, machine=machine(*packages), **run)


def _timing(args: _TimingOptions, bar: tqdm) -> Timing:
    from tests.benchmarks.interleaved_timing import Timing

    return Timing(args.seed, args.clock, args.burst, bar.update)


def _latency(args: Latency) -> Output:
    sizes = tuple(image_size(text, 64, landscape=False) for text in args.sizes)
    from tests.benchmarks import latency

    output, targets = _output("latency", args), []
    if "stages" in args.only:
        with progress("stages", "frame", args.frames + latency.WARM_UP) as bar:
            found = latency.latencies(sizes, args.frames, _timing(args, bar))
        totals = latency.total_rows(found)
        output.table("image to points in 3D", totals, "totals")
        output.table("stages, median milliseconds", latency.stage_rows(found), "stages")
        targets += latency.latency_targets(totals)
    if "growth" in args.only:
        with progress("growth", "frame", args.frames + latency.WARM_UP) as bar:
            grown = latency.growth_rows(args.frames, _timing(args, bar))
        output.table("growth, tracked", grown, "growth")
        targets += latency.growth_targets(grown)
    if args.memory:
        with progress("memory", "frame") as bar:
            megabytes = latency.memory_growth(args.memory, _timing(args, bar))
        output.table("memory", [{"frames": args.memory, "growth_mb": megabytes}])
        targets.append(latency.memory_target(args.memory, megabytes))
    output.claims(targets)
    return output


def _peers(args: Peers) -> Output:
    from tests.benchmarks import peers

    output, results = _output("peers", args), {}
    output.document |= {"missing": peers.missing(), "works": {}}
    for module, package in output.document["missing"].items():
        output.note(f"{module} is not installed and left out: pip install {package}")
    for name in args.only:
        with progress(name, "frame", args.frames + peers.WARM_UP) as bar:
            results[name] = peers.run_work(name, args.frames, args.slow_frames, _timing(args, bar))
        work = output.document["works"][name] = results[name].summary
        refused = f", {work['refused']} refused" if work["refused"] else ""
        title = f"{name}: {work['points']} points from {work['samples']} pixels, {work['frames']} frames{refused}"
        output.table(title, work["rows"], "")
    output.claims(peers.targets(results))
    return output


def _envs(args: Envs) -> Output:
    sizes = [image_size(text, 16) for text in args.sizes]
    from tests.benchmarks.env_speed import WARM_UP, speed_row, speed_targets
    from tests.benchmarks.interleaved_timing import opengl

    driver, no_opengl = opengl()
    output = _output("envs", args, "mujoco", "gymnasium")
    output.document["machine"]["opengl"] = driver or "none"
    output.document["missing"] = {"gl": no_opengl} if no_opengl else {}
    output.note("\n".join(f"{name}: {what}" for name, what in output.document["machine"].items()))
    renderers = [name for name in args.renderers if name != "gl" or driver]
    if no_opengl and "gl" in args.renderers:
        output.note(f"no OpenGL here, rays alone: {no_opengl}")
    courses = list(product(args.envs, sizes, renderers))
    rows = []
    with progress("envs", "step", len(courses) * (args.steps + WARM_UP)) as bar:
        for course in courses:
            bar.set_postfix_str("{} {} {}".format(*course))
            rows.append(speed_row(*course, args.steps, _timing(args, bar)))
    output.table("steps per second", rows, "single")
    output.claims(speed_targets(rows))
    return output


_COMMANDS: Final[dict[str, tuple[type, Callable[[Any], Output]]]] = {
    "latency": (Latency, _latency),
    "peers": (Peers, _peers),
    "envs": (Envs, _envs),
}
