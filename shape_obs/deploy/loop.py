"""Run the deployment loop: observe, check and act at the environment's fixed rate, and always stop at the end."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from contextlib import nullcontext
from typing import TYPE_CHECKING, Any, NamedTuple

from shape_obs.deploy.controller import check_controller, checked_action
from shape_obs.deploy.run_log import Report, RunLog, Tally
from shape_obs.deploy.run_recorder import RunRecorder
from shape_obs.deploy.safety import Gate, Judgement, Limits, Watchdog
from shape_obs.deploy.supervision import Interrupted, SignalStop, supervised
from shape_obs.frame import Frame
from shape_obs.shape import Detection
from shape_obs.utils.errors import ending, message_of
from shape_obs.utils.timing import Clock

if TYPE_CHECKING:
    import gymnasium as gym


class Step(NamedTuple):
    """A step of the loop.

    Attributes:
        step: Number of the step.
        frame: Frame of the camera; None if the camera failed.
        detection: Shapes that were found in the frame.
        judgement: Decision that was based on them.
        action: Action of the controller, of shape ``(A,)``; None if nothing was sent.
    """

    step: int
    frame: Frame | None
    detection: Detection
    judgement: Judgement
    action: Any


OnStep = Callable[[Step], None]


def deploy(
    env: gym.Env[Any, Any],
    controller: Any,
    limits: Limits | None = None,
    *,
    steps: int | None = None,
    seconds: float | None = None,
    until_reached: int = 0,
    log: RunLog | None = None,
    record: RunRecorder | None = None,
    on_step: OnStep | None = None,
    park: bool = True,
    close: bool = True,
) -> Report:
    """Run a controller on a robot, and stop, park and disconnect the robot at the end, also after an error.

    Nothing moves, also no robot parks, before both robot and camera are connected. The first error is raised, with the
    messages of later ones as its notes.

    The environment keeps the rate with absolute deadlines, and its action limiter clips actions, limits steps and keeps
    the robot in the workspace. SIGINT, SIGTERM, SIGQUIT and, unless ``nohup`` made the process ignore it, SIGHUP stop
    the robot at once, from a thread, if this function is called in the main thread.

    Args:
        env: ``ShapeObs/D455-v0`` with a robot, in a ``ShapeObservation`` and, if there is a goal, a ``ShapeGoal``.
        controller: A ``Controller``.
        limits: When to hold and when to stop; ``limits.max_age`` replaces that of the environment.
        steps: Largest number of steps; None for no limit.
        seconds: Largest duration; None for no limit.
        until_reached: Number of consecutive frames with the goal reached after which the run ends; 0 to continue.
        log: Log of steps and report, which a thread writes.
        record: Recording of frames, actions, rewards and states, which threads write; the run is one episode of it. The
            caller closes it.
        on_step: Called after each step.
        park: Whether to send the robot to its safe pose at the end.
        close: Whether to disconnect camera and robot at the end.

    Raises:
        Interrupted: A signal asked the process to end. The robot was stopped and parked; ``report`` has the report.
        ValueError: The controller acts in other coordinates than the robot, or returned an invalid action; or the
            environment has no robot or no ``ShapeObservation``.
        SourceError: The camera was not available at the start.
        RobotError: The robot was not available at the start, or cannot stop or park.
        OSError: The log or the recording cannot be written.
    """
    robot_env: Any = env.unwrapped
    if getattr(robot_env, "robot", None) is None:
        raise ValueError("deploy needs an environment with a robot: gym.make('ShapeObs/D455-v0', robot=...).")
    try:
        env.get_wrapper_attr("detection")
    except AttributeError:
        raise ValueError("deploy needs an environment that finds shapes: wrap it in ShapeObservation.") from None
    run: _Run | None = None
    try:
        with log or nullcontext(), supervised(env, park=park, close=close) as signals:
            run = _Run(env, controller, limits or Limits(), log, record, on_step, signals)
            return run.go(steps, seconds, until_reached)
    except Interrupted as interrupted:
        interrupted.report = None if run is None else run.report
        raise


class _Run:
    """A single run of the loop, from reset to report."""

    def __init__(
        self,
        env: gym.Env[Any, Any],
        controller: Any,
        limits: Limits,
        log: RunLog | None,
        record: RunRecorder | None,
        on_step: OnStep | None,
        signals: SignalStop,
    ) -> None:
        self._env, self._controller, self._on_step = env, controller, on_step
        self._log, self._record = log, record
        self._robot_env: Any = env.unwrapped
        self._clock: Clock = self._robot_env.clock
        self._robot_env.max_age = limits.max_age
        dt = self._robot_env.rate.dt
        if dt >= limits.max_age:
            warnings.warn(
                f"a step takes {dt:g} s and a motion ends {limits.max_age:g} s after the exposure of "
                "its image, so motions end before the next step: raise the rate, or max_age.",
                UserWarning,
                stacklevel=3,
            )
        self._spec = self._robot_env.robot.action_spec
        self._limits, self._gate, self._tally = limits, Gate(limits), Tally()
        self._signals = signals
        self._info: dict[str, Any] = {}
        self._count, self._begin = 0, self._clock.now()
        self.report: Report | None = None

    def go(self, steps: int | None, seconds: float | None, until_reached: int) -> Report:
        """Run the loop, and stop the robot before the report is made."""
        interlock = self._robot_env.interlock
        expired, ended, failed = interlock.expired, "", True
        try:
            with ending(interlock.end):
                ended, failed = self._checked_loop(steps, seconds, until_reached)
        except Interrupted as interrupted:
            ended, failed = str(interrupted), False
            raise
        except BaseException as error:  # also SystemExit: the report gives the reason; raised again below
            ended, failed = f"{type(error).__name__}: {message_of(error)}", True
            raise
        finally:
            self.report = self._tally.report(
                steps=self._count,
                seconds=self._clock.now() - self._begin,
                overruns=self._robot_env.rate.overruns,
                expired=interlock.expired - expired,
                ended=ended,
                failed=failed,
                success=bool(self._info["is_success"]) if "is_success" in self._info else None,
            )
            if self._log is not None:
                self._log.report(self.report.to_dict())
        if self._record is not None and self._robot_env.frame is not None:  # the frame after the last step
            self._record.frame(self._robot_env.frame, self._robot_env.interlock.state())
            self._record.write()
        return self.report

    def _checked_loop(self, steps: int | None, seconds: float | None, until_reached: int) -> tuple[str, bool]:
        """Run the loop with a controller that suits the robot; afterwards no signal interrupts the end of the run."""
        try:
            with self._signals.unmasked():
                check_controller(self._controller, self._spec, self._env)
                return self._loop(steps, seconds, until_reached)
        finally:
            self._signals.raising = False

    def _loop(self, steps: int | None, seconds: float | None, until_reached: int) -> tuple[str, bool]:
        """Step until the run ends; return the reason, and whether it is an error."""
        observation, self._info = self._env.reset()
        self._begin, reached = self._clock.now(), 0
        if self._record is not None:
            self._record.begin(self._robot_env)
        interlock, limits = self._robot_env.interlock, self._limits
        with Watchdog(lambda: interlock.trip("watchdog"), limits.watchdog, self._clock) as watchdog:
            while True:
                watchdog.feed()
                self._signals.check()
                judgement = self._gate.judge(self._info, self._clock.now())
                if judgement.move == "stop":
                    return judgement.reason, True
                observation, over = self._step(observation, judgement)
                self._count += 1
                reached = reached + 1 if self._info.get("is_success") else 0
                errors = [self._info[name] for name in ("camera_error", "robot_error") if name in self._info]
                if watchdog.expired:
                    return f"the loop hung for {limits.watchdog} s: the watchdog stopped the robot", True
                if errors:
                    return errors[0], True
                if over:
                    return "the episode was over", False
                if until_reached and reached >= until_reached:
                    return f"the goal was reached in {reached} consecutive frames", False
                if self._count == steps or (seconds is not None and self._clock.now() - self._begin >= seconds):
                    return "time limit reached", False

    def _step(self, observation: Any, judgement: Judgement) -> tuple[Any, bool]:
        """Act or hold; return the next observation, and whether the episode is over."""
        robot_env, tally, info = self._robot_env, self._tally, self._info
        frame, seen_at, begin = robot_env.frame, robot_env.seen_at, self._clock.now()
        detection: Detection = self._env.get_wrapper_attr("detection")
        source, state = sum(getattr(robot_env.source, "timings", {}).values()), robot_env.interlock.state()
        if self._record is not None:
            self._record.frame(frame, state)
        action = None
        if judgement.move == "act":
            action = checked_action(self._controller.act(observation), self._spec, self._controller)
        acted = self._clock.now()
        following, reward, terminated, truncated, self._info = self._env.step(action)
        if robot_env.withheld:  # the image became too old before the motion was sent
            action, judgement = None, Judgement("hold", robot_env.withheld, f"not sent: {robot_env.withheld}")
            withheld = getattr(self._controller, "withheld", None)
            if callable(withheld):
                withheld()
        if self._record is not None:
            self._record.step(action, reward, terminated, truncated)
        if action is None:
            tally.held += 1
            tally.reasons[judgement.cause] += 1
        else:
            tally.acted += 1
        times = {
            "source": source,
            "detect": detection.timings["total"],
            "between": 1e3 * (begin - seen_at) - detection.timings["total"],
            "act": 1e3 * (acted - begin),
            "send": 1e3 * (robot_env.sent_at - acted),
        }
        times["own"] = sum(times.values())
        if frame is not None and frame.received is not None:
            times["age"] = 1e3 * (seen_at - frame.received) - source
        tally.time(times)
        guarded = robot_env.guarded if action is not None else None
        if guarded is not None:
            tally.guarded.update(clipped=guarded.clipped, capped=guarded.capped, boxed=guarded.boxed)
        if self._log is not None:
            self._log.step(
                {
                    "step": self._count,
                    "stamp": info["stamp"],
                    "frame": info.get("frame"),
                    "lag": info.get("lag"),
                    "move": judgement.move,
                    "reason": judgement.reason,
                    "shapes": tuple(detection),
                    "warning": detection.warning,
                    "state": state,
                    "action": action,
                    "motion": None if guarded is None else guarded.motion,
                    "late_ms": max(0.0, -1e3 * robot_env.slack),
                    "ms": {name: round(value, 3) for name, value in times.items()},
                }
            )
        if self._on_step is not None:
            self._on_step(Step(self._count, frame, detection, judgement, action))
        return following, terminated or truncated
