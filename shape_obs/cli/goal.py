"""``shape-obs goal``: the shape that is there now, as a goal for later."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from tqdm import tqdm

from shape_obs.cli.files import write_image
from shape_obs.cli.options import CellArguments, make_cell, make_robot, warnings_as_lines
from shape_obs.drawing import draw_detection


@dataclass(frozen=True)
class Arguments(CellArguments):
    """Record the shape that is seen now as a goal: lay the object as it should lie, and run this.

    With --robot the shape is numbered from where the robot holds it; the robot is asked where it is and not moved.
    """

    out: Annotated[Path, tyro.conf.arg(aliases=("-o",))] = Path("goal.yaml")
    """Where the goal is written to; its picture is written beside it."""
    shape: str | None = None
    """The name of the shape; default the first of the config."""
    frames: int = 60
    """How many frames are looked at, until one shows all points."""
    unmeasured: bool = False
    """Take points that are hidden or have no depth too, where they are thought to be."""
    json: bool = False
    """Print the goal as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the command; returns the exit code."""
    args = tyro.cli(Arguments, args=list(argv), prog="shape-obs goal")
    if args.frames < 1:
        raise ValueError(f"--frames: expected 1 or more, got {args.frames}.")
    robot = None if args.robot is None else _still(args)
    env = make_cell(args, robot)
    try:
        with warnings_as_lines("shape-obs goal"):
            env.reset()
            target, detection = _first_whole(env, args)
        rgb = env.get_wrapper_attr("frame").rgb
    finally:
        env.close()
    target.save(args.out)
    picture = args.out.with_suffix(".png")
    write_image(picture, draw_detection(rgb, detection))
    if args.json:
        print(json.dumps(target.to_dict()))
    else:
        low, high = np.min(target.points, axis=0), np.max(target.points, axis=0)
        unit = "px" if target.frame == "pixels" else "m"
        spread = ", ".join(f"{a:.3f} ... {b:.3f}" for a, b in zip(low, high, strict=True))
        print(f"goal            {len(target.points)} points, frame {target.frame!r}, {spread} {unit}")
        print(f"written         {args.out}, {picture}")
    return 0


def _still(args: Arguments) -> Any:
    from shape_obs.deploy import DryRobot

    return DryRobot(make_robot(args))


def _first_whole(env: Any, args: Arguments) -> tuple[Any, Any]:
    """The first frame that makes a goal."""
    from shape_obs.wrappers import record_goal

    trouble = ""
    for left in tqdm(range(args.frames - 1, -1, -1), unit="frame", leave=False, file=sys.stderr):
        try:
            return record_goal(env, args.shape, unmeasured=args.unmeasured), env.get_wrapper_attr("detection")
        except ValueError as error:
            trouble = str(error)
        if left:
            *_, info = env.step(None)
            if "camera_error" in info:
                raise OSError(info["camera_error"])
    raise ValueError(f"no goal in {args.frames} frames: {trouble}")
