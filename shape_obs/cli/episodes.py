"""Episodes of a deployment: goals that a robot tells for each of its starts, and how often they were reached."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np

from shape_obs.deploy import Interrupted, Report, supervised
from shape_obs.wrappers import Target


class Starter:
    """Stands before a robot that goes to its start before an episode begins: only then is known what can be reached.

    All else is the robot's own.

    Args:
        robot: The robot.
    """

    def __init__(self, robot: Any) -> None:
        self._robot, self._there = robot, False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._robot, name)

    def go(self) -> None:
        """Go to the start of the next episode; the next ``reset`` finds the robot there.

        Raises:
            RobotError: It cannot.
        """
        self._robot.connect()
        self._robot.reset()
        self._there = True

    def reset(self) -> None:
        """Go to the start of an episode, or stay there."""
        if not self._there:
            self._robot.reset()
        self._there = False


class RobotGoals(gym.Wrapper[Any, Any, Any, Any]):
    """Tells each episode the goal that the robot knows for its start: ``robot.goal``, points (K,3) [m], base frame.

    Args:
        env: With a ``ShapeGoal`` and a robot that is a ``Starter``.
        told: Who knows the goals; laid out as its ``goal_layout`` says, where it does.

    Raises:
        ValueError: It knows none.
    """

    def __init__(self, env: gym.Env[Any, Any], told: Any) -> None:
        super().__init__(env)
        if not hasattr(type(told), "goal"):
            raise ValueError(
                f"--goal robot: {type(told).__name__} knows no goal; give --goal FILE, as `shape-obs goal` writes it."
            )
        self._told = told

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Go to a start, ask for a goal, and look."""
        cell: Any = self.env.unwrapped
        cell.robot.go()
        points = np.asarray(self._told.goal, np.float64).reshape(-1, 3)
        self.goal = Target(tuple(map(tuple, points.tolist())), layout=getattr(self._told, "goal_layout", {}))
        return self.env.reset(seed=seed, options={**(options or {}), "goal": self.goal})


@dataclass(frozen=True)
class Episodes:
    """How episodes went.

    Args:
        reports: Of each of them.
        true_mm: Mean distance of the object's true points from the goal's in the last frame of each, millimetres; None
            where nobody knows it.
        threshold_mm: Below which that counts as reached.
    """

    reports: Sequence[Report]
    true_mm: Sequence[float | None]
    threshold_mm: float

    def to_dict(self) -> dict[str, Any]:
        """The episodes as JSON-able values."""
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
    """Play episodes one after the other, then stop and park the robot and disconnect, whatever happened.

    Args:
        env: With a ``ShapeGoal`` or not.
        run: Plays the episode of a number, without parking or disconnecting.
        count: How many at most; the first in which the camera or the robot fails or the loop hangs is the last.
        threshold: Metres below which a goal is reached in truth.
        park: Whether to park in the end.

    Raises:
        Interrupted: A signal asked the process to end; ``report`` holds the episodes that were played.
    """
    cell, reports, true_mm = env.unwrapped, [], []
    try:
        with supervised(env, park=park):
            for number in range(count):
                reports.append(run(number))
                true_mm.append(_true_distance(env))
                if reports[-1].failed and (cell.frame is None or "watchdog" in reports[-1].ended):
                    break
    except Interrupted as interrupted:
        interrupted.report = Episodes(reports, true_mm, 1e3 * threshold) if reports else interrupted.report
        raise
    return Episodes(reports, true_mm, 1e3 * threshold)


def _true_distance(env: Any) -> float | None:
    """Millimetres of the true points from the goal's, in the last frame; None where nobody knows."""
    cell = env.unwrapped
    frame, truth = cell.frame, getattr(cell.robot, "truth", None)
    goal = env.get_wrapper_attr("goal") if env.has_wrapper_attr("goal") else None
    if frame is None or frame.number is None or truth is None or goal is None:
        return None
    points, wanted = truth(frame.number), np.asarray(goal.points)
    if points.shape != wanted.shape:
        return None
    return float(1e3 * np.linalg.norm(points - wanted, axis=1).mean())
