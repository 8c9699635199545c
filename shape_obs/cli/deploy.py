"""``shape-obs deploy``: run a policy or a controller on a robot, from the camera alone."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass
from math import inf
from pathlib import Path
from types import TracebackType
from typing import Annotated, Any

from shape_obs.cli.controller import ControllerArguments, Deployment, check_controller, make_deployment
from shape_obs.cli.options import RATE, warnings_as_lines
from shape_obs.cli.outputs import Overwrite, check_outputs
from shape_obs.cli.parsing import Option, parse
from shape_obs.cli.rerun_option import TARGET, check_target, open_rerun, rerun_file, with_rerun_value
from shape_obs.utils.errors import UsageError, run_last


@dataclass(frozen=True)
class Arguments(ControllerArguments):
    """Run a trained policy or another controller on a robot at a fixed rate, using only the camera.

    Nothing moves before robot and camera are connected. At the end of every run that moved the robot, it is stopped,
    sent to its safe pose and disconnected, also after Ctrl-C, SIGTERM, SIGQUIT and, unless run under nohup, SIGHUP. The
    exit code is 1 if the camera or the robot failed, the shape stayed lost, or the loop hung, and 128 plus the signal's
    number after a signal.
    """

    seconds: Annotated[float, Option("SECONDS", "run", above=0)] = 60.0
    """Longest duration of the run; inf for no limit."""
    until_reached: Annotated[int, Option("N", "run", least=0)] = 0
    """End the run when the goal has been reached in this many consecutive frames; 0: do not end it."""
    hold: Annotated[float, Option("SECONDS", "safety", least=0)] = 0.5
    """Seconds to wait without moving for a lost or old shape before the run ends."""
    min_valid: Annotated[float, Option("SHARE", "safety", least=0, most=1)] = 0.5
    """Share of the points that must be measured."""
    max_age: Annotated[float, Option("SECONDS", "safety", above=0)] = 0.2
    """Largest age of an image to act on, in seconds since its exposure; motions end after that time."""
    watchdog: Annotated[float, Option("SECONDS", "safety", above=0)] = 2.0
    """Seconds after which a hanging loop is ended; its motion ends earlier, after --max-age."""
    max_step: Annotated[tuple[float, ...] | None, Option("X ...", "safety")] = None
    """Largest change of each coordinate in one step, in the robot's units."""
    workspace_low: Annotated[tuple[float, ...] | None, Option("X ...", "safety")] = None
    """Lower limit of each coordinate, in the robot's units."""
    workspace_high: Annotated[tuple[float, ...] | None, Option("X ...", "safety")] = None
    """Upper limit of each coordinate, in the robot's units."""
    park: Annotated[bool, Option(group="safety")] = True
    """Send the robot to its safe pose at the end; --no-park leaves it where it is."""
    log: Annotated[Path | None, Option("FOLDER", "output")] = None
    """Folder for the log: the setup, one line per step, and the report."""
    record: Annotated[Path | None, Option("FOLDER", "output")] = None
    """Folder for a recording of the run: frames, actions, rewards and the robot's state; see `shape-obs replay`."""
    view: Annotated[int | None, Option("PORT", "output", least=0, most=65535)] = None
    """Port of a web page that shows the camera's image and the shapes (needs the extra 'view')."""
    rerun: Annotated[str | None, Option(TARGET, "output", check=check_target)] = None
    """Log the run to rerun: to FILE.rrd, or to a running viewer by its address. Without a value, open the viewer, or,
    if there is no display, write a file next to --log or else deploy.rrd (needs the extra 'rerun')."""
    overwrite: Overwrite = False
    """Replace an existing FILE.rrd; logs and recordings are never replaced."""
    json: Annotated[bool, Option(group="output")] = False
    """Print the report as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the command and return the exit code."""
    args = parse(Arguments, with_rerun_value(argv), "shape-obs deploy", check_controller)
    box = _box(args)
    check_outputs(args, rerun_file(args.rerun, args.log or Path("deploy")))
    if args.log is not None and args.record is not None and args.log.resolve().is_relative_to(args.record.resolve()):
        raise UsageError(f"--log: expected a folder outside of --record {args.record}, got {args.log}.")
    from threadpoolctl import threadpool_limits

    with warnings_as_lines("shape-obs deploy"), threadpool_limits(1):  # small networks are slower on many threads
        return _run(args, box)


def _run(args: Arguments, box: Any) -> int:
    from shape_obs.cli.episodes import play
    from shape_obs.deploy import Interrupted, Limits, RunLog, RunRecorder, deploy
    from shape_obs.deploy.run_log import check_new_log

    for number in (None,) if args.episodes is None else range(args.episodes):
        if args.log is not None:
            check_new_log(_log_folder(args.log, number))
    limits = Limits(args.hold, args.min_valid, args.max_age, args.watchdog)
    setup = make_deployment(args, max_step=args.max_step, workspace=box)
    header = _header(setup, limits)
    recorder = None if args.record is None else RunRecorder(args.record)

    def run(number: int | None = None) -> Any:
        """Run once. Each of several episodes gets its own log, and the robot stays connected after it."""
        return deploy(
            setup.env,
            setup.controller,
            limits,
            steps=setup.arguments.steps,
            seconds=None if args.seconds == inf else args.seconds,
            until_reached=args.until_reached,
            log=None if args.log is None else RunLog(_log_folder(args.log, number), header),
            record=recorder,
            on_step=shown.step,
            park=args.park and number is None,
            close=number is None,
        )

    def show(report: Any) -> None:
        recorded = None if recorder is None else recorder.close()
        kept = {} if recorded is None else {"recording": recorded.to_dict()}
        print(json.dumps({**report.to_dict(), **kept}) if args.json else report)
        if recorded is not None and not args.json:
            print(
                f"recording       {recorded.frames} frames with {recorded.actions} actions in {recorded.path}, "
                f"dropped: {recorded.dropped}"
            )

    try:
        with recorder or nullcontext(), _Progress(setup.arguments, setup.env) as shown:
            if args.episodes is None:
                report = run()
                failed = report.failed
            else:
                report = play(setup.env, run, args.episodes, setup.threshold, args.park)
                failed = any(one.failed for one in report.reports)
    except Interrupted as interrupted:
        if interrupted.report is not None:
            show(interrupted.report)
        raise
    show(report)
    return 1 if failed else 0


def _log_folder(log: Path, number: int | None) -> Path:
    return log if number is None else log / f"episode-{number:03}"


def _header(setup: Deployment, limits: Any) -> dict[str, Any]:
    """Return the header of the log: options, robot, limits and detector."""
    from shape_obs.config.config_file import schema_hash
    from shape_obs.robot import robot_name

    detector = setup.env.get_wrapper_attr("detector")
    schema = {"shapes": detector.shapes, "clustering": detector.config.clustering}
    return {
        "options": {name: str(value) for name, value in vars(setup.arguments).items() if value is not None},
        "robot": robot_name(setup.robot),
        "action_spec": setup.robot.action_spec,
        "limits": limits,
        "schema": schema_hash({**schema, "features": setup.env.get_wrapper_attr("features")}),
        "detector": detector.config,
    }


class _Progress:
    """Show the steps in a progress bar and, with ``--view`` and ``--rerun``, on a web page and in rerun."""

    def __init__(self, args: Arguments, env: Any) -> None:
        from tqdm import tqdm

        self._views: list[Any] = []
        self._end = ExitStack()
        if args.view is not None:
            from shape_obs.deploy.view import LiveView

            page = LiveView(args.view, env)
            self._views.append(page)
            print(f"shape-obs deploy: live view at {page.url}", file=sys.stderr)
        if args.rerun is not None:
            from shape_obs.deploy.view import RerunView

            stream = open_rerun(args.rerun, args.log or Path("deploy"), "shape-obs deploy")
            self._views.append(RerunView(self._end.enter_context(stream).recording, env))
        rate = RATE if args.rate is None else args.rate
        total = args.steps if args.steps is not None else None if args.seconds == inf else round(args.seconds * rate)
        total = total and total * (args.episodes or 1)
        self._bar = tqdm(total=total, unit="step", leave=False, file=sys.stderr)

    def step(self, moment: Any) -> None:
        """Show one step."""
        self._bar.update()
        self._bar.set_postfix_str(moment.judgement.cause, refresh=False)
        for view in self._views:
            view.show(moment)

    def __enter__(self) -> _Progress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        run_last(error, self._bar.close, *(view.close for view in self._views), self._end.close)


def _box(args: Arguments) -> Any:
    low, high = args.workspace_low, args.workspace_high
    if low is None and high is None:
        return None
    if low is None or high is None:
        raise UsageError("--workspace-low and --workspace-high: give both, one number per coordinate.")
    return low, high
