"""Episodes of a deployment: a new start and goal for each, and how often the goals were reached."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np

from shape_obs.deploy import Interrupted, Report, supervised
from shape_obs.wrappers import Target


class StartFirst:
    """Wrap a robot so that it goes to its start before the episode's goal is chosen.

    Which goals can be reached depends on the start. All other attributes are those of the robot.

    Args:
        robot: The robot.

    Attributes:
        at_start: Whether the next ``reset`` finds the robot at its start.
    """

    at_start: bool

    def __init__(self, robot: Any) -> None:
        self._robot, self.at_start = robot, False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._robot, name)

    def reset(self) -> None:
        """Go to the start of an episode, unless the robot is there."""
        if not self.at_start:
            self._robot.reset()
        self.at_start = False


class RobotGoals(gym.Wrapper[Any, Any, Any, Any]):
    """Give each episode the goal that a simulated robot provides for its start.

    The goal is ``robot.goal``, points of shape (K, 3) in metres in the base frame, laid out as ``robot.goal_layout``
    says if the robot has it.

    Args:
        env: An environment with a ``ShapeGoal`` and a ``StartFirst`` robot.
        robot: The robot that provides the goals.

    Raises:
        ValueError: The robot provides no goals.
    """

    def __init__(self, env: gym.Env[Any, Any], robot: Any) -> None:
        super().__init__(env)
        if not hasattr(type(robot), "goal"):
            name = type(robot).__name__
            raise ValueError(f"--goal robot: {name} provides no goals; give --goal FILE (see `shape-obs goal`).")
        self._goals_of = robot

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Go to a start, take its goal, and reset the environment with it."""
        inner: Any = self.env.unwrapped
        inner.connect()
        inner.robot.at_start = False
        inner.interlock.reset()
        inner.robot.at_start = True
        points = np.asarray(self._goals_of.goal, np.float64).reshape(-1, 3)
        self.goal = Target(tuple(map(tuple, points.tolist())), layout=getattr(self._goals_of, "goal_layout", {}))
        return self.env.reset(seed=seed, options={**(options or {}), "goal": self.goal})


@dataclass(frozen=True)
class Episodes:
    """Results of several episodes.

    Args:
        reports: The report of each episode.
        true_mm: For each episode, the mean distance in millimetres of the object's true points from the goal in the
            last frame; None if the true points are unknown.
        threshold_mm: The distance below which the goal counts as reached.
    """

    reports: Sequence[Report]
    true_mm: Sequence[float | None]
    threshold_mm: float

    def to_dict(self) -> dict[str, Any]:
        """Return the episodes as JSON values."""
        known = self._known()
        return {
            "episodes": [
                {**report.to_dict(), "true_mm": distance}
                for report, distance in zip(self.reports, self.true_mm, strict=True)
            ],
            "success": self._share(bool(report.success) for report in self.reports),
            "true_success": self._share(distance < self.threshold_mm for distance in known) if known else None,
            "failed": sum(report.failed for report in self.reports),
        }

    def __str__(self) -> str:
        reports, known = self.reports, self._known()
        steps, seconds = sum(report.steps for report in reports), sum(report.seconds for report in reports)
        lines = [
            f"episodes        {len(reports)}, failed: {self.to_dict()['failed']}",
            f"steps           {steps} in {seconds:.1f} s ({steps / max(seconds, 1e-9):.2f} Hz), "
            f"overruns: {sum(report.overruns for report in reports)}",
            f"acted           {sum(report.acted for report in reports)}, "
            f"held: {sum(report.held for report in reports)}",
        ]
        if any(report.success is not None for report in reports):
            reached = sum(bool(report.success) for report in reports)
            lines.append(f"goal            reached in {reached} of {len(reports)} episodes, by the camera")
        if known:
            reached = sum(distance < self.threshold_mm for distance in known)
            lines.append(
                f"  in truth      reached in {reached} of {len(known)}: nearer than {self.threshold_mm:g} mm; median "
                f"{np.median(known):.1f} mm"
            )
        return "\n".join(lines)

    def _known(self) -> list[float]:
        return [distance for distance in self.true_mm if distance is not None]

    @staticmethod
    def _share(reached: Any) -> float:
        return float(np.mean(list(reached)))


def play(env: Any, run: Callable[[int], Report], count: int, threshold: float, park: bool) -> Episodes:
    """Run episodes one after another, then stop, park and disconnect the robot, even after an error.

    Args:
        env: The environment, with or without a ``ShapeGoal``.
        run: Runs the episode with a given number, without parking or disconnecting.
        count: Largest number of episodes; none follows one in which the camera or the robot failed or the loop hung.
        threshold: Mean distance of the true points in metres below which a goal counts as reached.
        park: Whether to park the robot at the end.

    Raises:
        Interrupted: A signal ended the process; ``report`` holds the episodes so far.
    """
    inner, reports, true_mm = env.unwrapped, [], []
    try:
        with supervised(env, park=park):
            for number in range(count):
                reports.append(run(number))
                true_mm.append(_true_distance(env))
                if reports[-1].failed and (inner.frame is None or "watchdog" in reports[-1].ended):
                    break
    except Interrupted as interrupted:
        interrupted.report = Episodes(reports, true_mm, 1e3 * threshold) if reports else interrupted.report
        raise
    return Episodes(reports, true_mm, 1e3 * threshold)


def _true_distance(env: Any) -> float | None:
    """Return the mean distance of the true points from the goal in the last frame, in millimetres, if known."""
    inner = env.unwrapped
    frame, truth = inner.frame, getattr(inner.robot, "truth", None)
    goal = env.get_wrapper_attr("goal") if env.has_wrapper_attr("goal") else None
    if frame is None or frame.number is None or truth is None or goal is None:
        return None
    points, wanted = truth(frame.number), np.asarray(goal.points)
    if points.shape != wanted.shape:
        return None
    return float(1e3 * np.linalg.norm(points - wanted, axis=1).mean())
