"""``shape-obs deploy``: run a controller on a robot, from the camera alone."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from tqdm import tqdm

from shape_obs.cli.cell import CellArguments, make_cell, make_robot
from shape_obs.cli.source import read_settings, warnings_as_lines
from shape_obs.config import schema_hash
from shape_obs.loading import make_named
from shape_obs.robot import robot_name


@dataclass(frozen=True)
class Arguments(CellArguments):
    """Run a controller on a robot at a fixed rate, from the camera alone.

    However it ends, the robot is stopped, sent to its safe pose and disconnected. Exit code 1 when the camera or the
    robot failed, the shape stayed lost, or the watchdog bit.
    """

    controller: str = "shape_obs.deploy:Still"
    """What acts, as module:Class with act(observation); shape_obs.deploy has Still, Sway and Script."""
    controller_set: tuple[str, ...] = ()
    """KEY=VALUE: arguments of the controller's class, such as share=0.2."""
    goal: Path | None = None
    """A goal, as `shape-obs goal` writes it; the observation then tells it to the controller."""
    seconds: float | None = 60.0
    """How long to run at most."""
    steps: int | None = None
    """How many steps to run at most."""
    until_reached: int = 0
    """End when the goal has been reached in so many frames one after the other; 0 goes on."""
    dry_run: bool = False
    """Do everything but move: the robot is asked where it is and never sent anything."""
    hold: float = 0.5
    """Seconds that a lost or old shape is waited for, without moving, before the run ends."""
    min_valid: float = 0.5
    """Share of the points that must be measured."""
    max_age: float = 0.2
    """Seconds that an image may be old when it is acted on."""
    watchdog: float = 2.0
    """Seconds after which the robot is stopped when the loop hangs."""
    max_step: tuple[float, ...] | None = None
    """How far each coordinate may move in a step, in the robot's units."""
    workspace_low: tuple[float, ...] | None = None
    """The least that each coordinate may become, in the robot's units."""
    workspace_high: tuple[float, ...] | None = None
    """The most."""
    park: bool = True
    """In the end send the robot to its safe pose; --no-park leaves it where it is."""
    log: Path | None = None
    """Folder for the log: what ran, a line for each step, the report."""
    view: int | None = None
    """Port of a web page that shows what the camera sees; needs the extra 'view'."""
    json: bool = False
    """Print the report as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the command; returns the exit code."""
    args = tyro.cli(Arguments, args=list(argv), prog="shape-obs deploy")
    from shape_obs.deploy import DryRobot, Limits, RunLog, deploy
    from shape_obs.wrappers import ShapeGoal, Target

    goal = None if args.goal is None else Target.load(args.goal)
    limits = Limits(args.hold, args.min_valid, args.max_age, args.watchdog)
    controller = make_named(args.controller, "--controller", read_settings(args.controller_set, "--controller-set"))
    robot = make_robot(args)
    if args.dry_run:
        robot = DryRobot(robot)
    env = make_cell(args, robot, max_step=args.max_step, workspace=_box(args))
    detector = env.get_wrapper_attr("detector")
    header = {
        "options": {name: str(value) for name, value in vars(args).items() if value is not None},
        "robot": robot_name(robot),
        "action_spec": robot.action_spec,
        "limits": limits,
        "schema": schema_hash(
            {"shapes": detector.shapes, "clustering": detector.config.clustering, "features": env.features}
        ),
        "detector": detector.config,
    }
    if goal is not None:
        env = ShapeGoal(env, goal=goal)
    log = None if args.log is None else RunLog(args.log, header)
    with warnings_as_lines("shape-obs deploy"), _Progress(args, env) as shown:
        report = deploy(
            env,
            controller,
            limits,
            steps=args.steps,
            seconds=args.seconds,
            until_reached=args.until_reached,
            log=log,
            on_step=shown.step,
            park=args.park,
        )
    print(json.dumps(report.to_dict()) if args.json else report)
    return 1 if report.failed else 0


class _Progress:
    """The bar, and the web page where one is asked for."""

    def __init__(self, args: Arguments, env: Any) -> None:
        self._view = None
        if args.view is not None:
            from shape_obs.deploy.view import LiveView

            self._view = LiveView(args.view, env)
            print(f"shape-obs deploy: live view at {self._view.url}", file=sys.stderr)
        total = args.steps if args.steps is not None else args.seconds and round(args.seconds * args.rate)
        self._bar = tqdm(total=total, unit="step", leave=False, file=sys.stderr)

    def step(self, moment: Any) -> None:
        """Show a step."""
        self._bar.update()
        self._bar.set_postfix_str(moment.judgement.cause, refresh=False)
        if self._view is not None:
            self._view.show(moment)

    def __enter__(self) -> _Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()
        if self._view is not None:
            self._view.close()


def _box(args: Arguments) -> Any:
    low, high = args.workspace_low, args.workspace_high
    if low is None and high is None:
        return None
    if low is None or high is None:
        raise ValueError("--workspace-low and --workspace-high: give both, one number for each coordinate.")
    return low, high
