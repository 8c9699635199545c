"""``shape-obs deploy``: run a controller on a robot, from the camera alone."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from shape_obs.cli.controller import Acting, ActingArguments, make_acting
from shape_obs.cli.options import RATE, warnings_as_lines
from shape_obs.config import schema_hash
from shape_obs.robot import robot_name


@dataclass(frozen=True)
class Arguments(ActingArguments):
    """Run a trained policy, or another controller, on a robot at a fixed rate, from the camera alone.

    However it ends, the robot is stopped, sent to its safe pose and disconnected: also on Ctrl-C, SIGTERM, SIGHUP and
    SIGQUIT. Exit code 1 if the camera or the robot failed, the shape stayed lost, or the loop hung; 128 plus its number
    after a signal.
    """

    seconds: float | None = 60.0
    """How long to run at most."""
    until_reached: int = 0
    """End when the goal has been reached in so many frames one after the other; 0 goes on."""
    hold: float = 0.5
    """Seconds that a lost or old shape is waited for, without moving, before the run ends."""
    min_valid: float = 0.5
    """Share of the points that must be measured."""
    max_age: float = 0.2
    """Seconds after its exposure within which an image may be acted on, and after which the motion ends."""
    watchdog: float = 2.0
    """Seconds after which a loop that hangs is ended; its motion has ended after --max-age."""
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
    with warnings_as_lines("shape-obs deploy"), threadpool_limits(1):  # a small network is slower in many threads
        return _run(args)


def _run(args: Arguments) -> int:
    from shape_obs.cli.episodes import play
    from shape_obs.deploy import Interrupted, Limits, RunLog, deploy

    limits = Limits(args.hold, args.min_valid, args.max_age, args.watchdog)
    acting = make_acting(args, max_step=args.max_step, workspace=_box(args))
    header = _header(acting, limits)

    def run(number: int | None = None) -> Any:
        """Run once; one of several episodes gets its own log, and the robot stays connected after it."""
        folder = args.log if args.log is None or number is None else args.log / f"episode-{number:03}"
        return deploy(
            acting.env,
            acting.controller,
            limits,
            steps=acting.arguments.steps,
            seconds=args.seconds,
            until_reached=args.until_reached,
            log=None if folder is None else RunLog(folder, header),
            on_step=shown.step,
            park=args.park and number is None,
            close=number is None,
        )

    def show(report: Any) -> None:
        print(json.dumps(report.to_dict()) if args.json else report)

    try:
        with _Progress(acting.arguments, acting.env) as shown:
            if args.episodes is None:
                report = run()
                failed = report.failed
            else:
                report = play(acting.env, run, args.episodes, acting.threshold, args.park)
                failed = any(one.failed for one in report.reports)
    except Interrupted as interrupted:
        if interrupted.report is not None:
            show(interrupted.report)
        raise
    show(report)
    return 1 if failed else 0


def _header(acting: Acting, limits: Any) -> dict[str, Any]:
    """What ran, for the log."""
    detector = acting.env.get_wrapper_attr("detector")
    told = {"shapes": detector.shapes, "clustering": detector.config.clustering}
    return {
        "options": {name: str(value) for name, value in vars(acting.arguments).items() if value is not None},
        "robot": robot_name(acting.robot),
        "action_spec": acting.robot.action_spec,
        "limits": limits,
        "schema": schema_hash({**told, "features": acting.env.get_wrapper_attr("features")}),
        "detector": detector.config,
    }


class _Progress:
    """The bar, and the web page where one is asked for."""

    def __init__(self, args: Arguments, env: Any) -> None:
        self._view = None
        if args.view is not None:
            from shape_obs.deploy.view import LiveView

            self._view = LiveView(args.view, env)
            print(f"shape-obs deploy: live view at {self._view.url}", file=sys.stderr)
        rate = RATE if args.rate is None else args.rate
        total = args.steps if args.steps is not None else args.seconds and round(args.seconds * rate)
        total = total and total * (args.episodes or 1)
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
