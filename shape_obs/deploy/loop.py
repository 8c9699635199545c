"""The deployment loop: observe, judge, act, at the environment's fixed rate, and stop whatever happens."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, NamedTuple

from shape_obs.deploy.controller import check_controller, checked_action
from shape_obs.deploy.gate import Gate, Judgement, Limits
from shape_obs.deploy.log import RunLog
from shape_obs.deploy.report import Report, Tally
from shape_obs.deploy.watchdog import Watchdog
from shape_obs.frame import Frame
from shape_obs.shape import Detection

if TYPE_CHECKING:
    import gymnasium as gym


class Step(NamedTuple):
    """What a step was decided on.

    Attributes:
        step: Its number.
        frame: What the camera saw; None where it failed.
        detection: What was found in it.
        judgement: What was made of that.
        action: (A,) what the controller did; None where it was not asked.
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
    on_step: OnStep | None = None,
    park: bool = True,
) -> Report:
    """Run a controller on a robot until it is done; then stop, park and disconnect the robot, whatever happened.

    The rate and its absolute deadlines are the environment's; so are the guard's action clip, step cap and workspace.

    Args:
        env: ``ShapeObs/D455-v0`` with a robot, in a ``ShapeObservation`` and, with a goal, a ``ShapeGoal``.
        controller: A ``Controller``.
        limits: When to hold and to stop.
        steps: How many at most; None for no limit.
        seconds: How long at most; None for no limit.
        until_reached: End when the goal has been reached in so many frames one after the other; 0 goes on.
        log: Where steps are written to.
        on_step: Called after each step.
        park: Whether to send the robot to its safe pose in the end.

    Raises:
        ValueError: The controller acts in other coordinates than the robot, or gave something else than an action; the
            environment has no robot or finds no shapes.
        SourceError: The camera was not there to begin with.
        RobotError: The robot was not there to begin with, or cannot stop or park.
    """
    cell: Any = env.unwrapped
    if getattr(cell, "robot", None) is None:
        raise ValueError("deploy needs an environment with a robot: gym.make('ShapeObs/D455-v0', robot=...).")
    try:
        env.get_wrapper_attr("detection")
    except AttributeError:
        raise ValueError("deploy needs an environment that finds shapes: wrap it in ShapeObservation.") from None
    with ExitStack() as finally_:
        # In reverse: stop, park, disconnect; each of them also when one before it fails.
        finally_.callback(env.close)
        if park:
            finally_.callback(cell.robot.park)
        finally_.callback(cell.robot.stop)
        if log is not None:
            finally_.enter_context(log)
        report = _Run(env, controller, limits or Limits(), log, on_step).go(steps, seconds, until_reached)
        if log is not None:
            log.report(report.to_dict())
    return report


class _Run:
    """One run, from reset to its report."""

    def __init__(
        self, env: gym.Env[Any, Any], controller: Any, limits: Limits, log: RunLog | None, on_step: OnStep | None
    ) -> None:
        self._env, self._controller, self._log, self._on_step = env, controller, log, on_step
        self._cell: Any = env.unwrapped
        self._spec = self._cell.robot.action_spec
        self._limits, self._gate, self._tally = limits, Gate(limits), Tally()
        check_controller(controller, self._spec, env)

    def go(self, steps: int | None, seconds: float | None, until_reached: int) -> Report:
        """Run it."""
        observation, info = self._env.reset()
        begin = time.monotonic()
        step, reached, ended, failed = 0, 0, "", False
        with Watchdog(self._cell.robot.stop, self._limits.watchdog) as watchdog:
            while not ended:
                watchdog.feed()
                judgement = self._gate.judge(info, time.monotonic())
                if judgement.move == "stop":
                    ended, failed = judgement.reason, True
                    break
                observation, info, terminated, truncated = self._step(step, observation, info, judgement, watchdog)
                step += 1
                reached = reached + 1 if info.get("is_success") else 0
                errors = [info[name] for name in ("camera_error", "robot_error") if name in info]
                if watchdog.bitten:
                    ended, failed = f"the loop hung for {self._limits.watchdog} s: the watchdog stopped the robot", True
                elif errors:
                    ended, failed = errors[0], True
                elif terminated or truncated:
                    ended = "the episode was over"
                elif until_reached and reached >= until_reached:
                    ended = f"the goal was reached in {reached} frames one after the other"
                elif step == steps or (seconds is not None and time.monotonic() - begin >= seconds):
                    ended = "the time was over"
        return self._tally.report(
            steps=step,
            seconds=time.monotonic() - begin,
            overruns=self._cell.rate.overruns,
            ended=ended,
            failed=failed,
            success=bool(info["is_success"]) if "is_success" in info else None,
        )

    def _step(
        self, step: int, observation: Any, info: dict[str, Any], judgement: Judgement, watchdog: Watchdog
    ) -> tuple[Any, dict[str, Any], bool, bool]:
        """Act or hold, and look again."""
        cell, tally = self._cell, self._tally
        frame, seen_at, begin = cell.frame, cell.seen_at, time.monotonic()
        detection: Detection = self._env.get_wrapper_attr("detection")
        source, state = sum(getattr(cell.source, "timings", {}).values()), cell.robot.state()
        action = None
        if judgement.move == "act":
            action = checked_action(self._controller.act(observation), self._spec, self._controller)
            # The controller took its time, and the image grew older.
            judgement = self._gate.judge(info, time.monotonic())
        if judgement.move == "act" and not watchdog.bitten:
            tally.acted += 1
        else:
            withheld = getattr(self._controller, "withheld", None)
            if action is not None and callable(withheld):
                withheld()
            action = None
            tally.held += 1
            tally.reasons[judgement.cause or "watchdog"] += 1
        acted = time.monotonic()
        following, _, terminated, truncated, next_info = self._env.step(action)
        times = {
            "source": source,
            "detect": detection.timings["total"],
            "between": 1e3 * (begin - seen_at) - detection.timings["total"],
            "act": 1e3 * (acted - begin),
            "send": 1e3 * (cell.sent_at - acted),
        }
        times["own"] = sum(times.values())
        if frame is not None and frame.received is not None:
            times["age"] = 1e3 * (seen_at - frame.received) - source
        tally.time(times)
        guarded = cell.guarded
        if guarded is not None:
            tally.guarded.update(clipped=guarded.clipped, capped=guarded.capped, boxed=guarded.boxed)
        if self._log is not None:
            self._log.step(
                {
                    "step": step,
                    "stamp": info["stamp"],
                    "frame": info.get("frame"),
                    "lag": info.get("lag"),
                    "move": judgement.move,
                    "reason": judgement.reason,
                    "shapes": [shape.to_dict() for shape in detection],
                    "state": state,
                    "action": action,
                    "motion": None if guarded is None else guarded.motion,
                    "late_ms": max(0.0, -1e3 * cell.slack),
                    "ms": {name: round(value, 3) for name, value in times.items()},
                }
            )
        if self._on_step is not None:
            self._on_step(Step(step, frame, detection, judgement, action))
        return following, next_info, terminated, truncated
