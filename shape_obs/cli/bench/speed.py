"""``shape-obs bench speed``: time each stage on this machine."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from typing import Annotated, Any, Literal

from shape_obs.cli.parsing import Option, parse
from shape_obs.utils.errors import install_hint

_SIZES = Literal["84x84", "160x120", "320x240", "640x480", "848x480", "1280x720", "1280x800"]


@dataclass(frozen=True)
class Arguments:
    """Time each stage on this machine: from mask, image and RGB-D image to 20 tracked points, and simulated steps.

    All stages take turns on the same frames, on one thread. Simulated steps need the extra 'sim'.
    """

    frames: Annotated[int, Option("N", "measurement", least=1)] = 300
    """Number of counted frames, and of steps."""
    sizes: Annotated[tuple[_SIZES, ...], Option(group="measurement")] = ("640x480", "1280x720")
    """Image sizes."""
    envs: Annotated[tuple[Literal["Cable", "Ring", "Cloth", "Hanging"], ...], Option(group="measurement")] = ("Cable",)
    """Simulated environments."""
    clock: Annotated[Literal["wall", "thread"], Option(group="measurement")] = "wall"
    """Clock: elapsed time, or the processor time of the thread, which hardly depends on other load."""
    json: Annotated[bool, Option(group="output")] = False
    """Print JSON instead of a table."""


def main(argv: Sequence[str]) -> int:
    """Run the command and return the exit code."""
    args = parse(Arguments, argv, "shape-obs bench speed")
    from tqdm import tqdm

    from shape_obs.bench.report import in_words, machine, markdown_table
    from shape_obs.bench.speed import WARM_UP, env_stages, image_stages

    envs, missing = args.envs, ""
    if find_spec("mujoco") is None:
        envs, missing = (), f"simulated steps were not timed, since MuJoCo is not installed: {install_hint('sim')}"
    stages = [image_stages, *(partial(env_stages, env) for env in envs)]
    rows: list[dict[str, Any]] = []
    total = len(stages) * len(args.sizes) * (args.frames + WARM_UP)
    with tqdm(total=total, unit="frame", desc="speed", leave=False, file=sys.stderr) as bar:
        for timed in stages:
            for size in args.sizes:
                width, height = map(int, size.split("x"))
                rows += timed((width, height), args.frames, args.clock, bar.update)
    if args.json:
        run = {"frames": args.frames, "clock": args.clock, "machine": machine(), "missing": missing, "stages": rows}
        print(json.dumps(run, indent=2))
    else:
        print(f"{in_words(machine())}; {args.frames} frames, {args.clock} clock\n\n{markdown_table(rows)}")
        if missing:
            print(f"\n{missing}")
    return 0
