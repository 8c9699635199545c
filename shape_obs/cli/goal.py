"""``shape-obs goal``: record the shape that the camera sees now as a goal for later."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from shape_obs.cli.options import NEEDS_CONFIG, RobotArguments, make_env, make_robot, warnings_as_lines
from shape_obs.cli.outputs import Overwrite, check_outputs
from shape_obs.cli.parsing import Option, parse
from shape_obs.utils.errors import UsageError, ending


@dataclass(frozen=True)
class Arguments(RobotArguments):
    """Record the current shape as a goal: lay the object into its goal shape, then run this command.

    With --robot, the points are numbered from where the robot holds the object; the robot's state is read, and it does
    not move.
    """

    out: Annotated[Path, Option("FILE", "output", "-o")] = Path("goal.yaml")
    """File for the goal; a picture of it is written to the same name with .png."""
    shape: Annotated[str | None, Option("NAME", "detection")] = None
    """Name of the shape; default: the first in the config."""
    frames: Annotated[int, Option("N", "detection", least=1)] = 60
    """Largest number of frames to wait for one that shows all points."""
    unmeasured: Annotated[bool, Option(group="detection")] = False
    """Also record points that are hidden or have no depth, at their estimated positions."""
    overwrite: Overwrite = False
    """Replace existing files."""
    json: Annotated[bool, Option(group="output")] = False
    """Print the goal as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the command and return the exit code."""
    args = parse(Arguments, argv, "shape-obs goal")
    if args.robot is None and args.config is None:
        raise UsageError(NEEDS_CONFIG)
    picture = args.out.with_suffix(".png")
    check_outputs(args, args.out, picture)
    from shape_obs.drawing import draw_detection, legible_scale
    from shape_obs.utils.arrays import write_image

    env = make_env(args, None if args.robot is None else _dry_robot(args))
    with ending(env.close), warnings_as_lines("shape-obs goal"):
        env.reset()
        target, detection = _first_complete(env, args)
        rgb = env.get_wrapper_attr("frame").rgb
    target.save(args.out)
    write_image(picture, draw_detection(rgb, detection, scale=legible_scale(rgb)))
    if args.json:
        print(json.dumps(target.to_dict()))
    else:
        unit = "px" if target.frame == "pixels" else "m"
        spread = ", ".join(f"{min(axis):.3f} ... {max(axis):.3f}" for axis in zip(*target.points, strict=True))
        print(f"goal            {len(target.points)} points, frame {target.frame!r}, {spread} {unit}")
        print(f"written         {args.out}, {picture}")
    return 0


def _dry_robot(args: Arguments) -> Any:
    from shape_obs.deploy import DryRobot

    return DryRobot(make_robot(args))


def _first_complete(env: Any, args: Arguments) -> tuple[Any, Any]:
    """Return the goal and the detection of the first frame that shows all points."""
    from tqdm import tqdm

    from shape_obs.wrappers import record_goal

    reason = ""
    for left in tqdm(range(args.frames - 1, -1, -1), unit="frame", leave=False, file=sys.stderr):
        try:
            return record_goal(env, args.shape, unmeasured=args.unmeasured), env.get_wrapper_attr("detection")
        except ValueError as error:
            reason = str(error)
        if left:
            *_, info = env.step(None)
            if "camera_error" in info:
                raise OSError(info["camera_error"])
    raise ValueError(f"no goal in {args.frames} frames: {reason}")
