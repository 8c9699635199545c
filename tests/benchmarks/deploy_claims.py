"""Measure the deployment loop without hardware: a simulated robot in front of a software D455.

The detected points are compared with the simulator's truth of the same frame, in a clean run and in a run with lost,
late, frozen and black frames and a hand over the object.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from shape_obs.geometry.polyline import arc_length
from tests.benchmarks.scores import SLIP, simulator_score
from tests.benchmarks.tables import Row, at_most, mean

Array = npt.NDArray[np.float64]

SECONDS: Final = 60.0
FAULTS: Final = {"drop": 0.05, "delay": 0.05, "freeze": 0.05, "black": 0.05, "occluder": 0.15}
_RATE: Final = 30.0  # hertz, of the loop and the camera
_WRONG: Final = 15.0  # mm
_OWN: Final = 25.0  # ms, 95th percentile
_OVERRUNS: Final = 1.0  # percent


class Seen:
    """Compare every frame on which the loop acts with the truth.

    Args:
        robot: The simulated robot, which has the truth.

    Attributes:
        mm: Mean error of the measured points of each frame that led to an action.
        slips: Frames that led to an action with a valid point more than half a gap from its position.
        wrong: Frames that led to an action with a slip, or a mean error of the measured points above 15 mm.
        hidden: Errors of single points that were reported hidden.
        stale: Actions on a frame that was used before, on a frozen one, or on a black one.
        oldest: Longest time from the exposure of an image to the decision to act on it, in seconds.
    """

    def __init__(self, robot: Any) -> None:
        self.robot, self._numbers = robot, set[int]()
        self.mm, self.hidden = list[float](), list[float]()
        self.slips = self.wrong = self.stale = 0
        self.oldest = 0.0

    def step(self, moment: Any) -> None:
        """Record one step of the loop."""
        frame, affected = moment.frame, self.robot.affected
        if moment.judgement.move != "act":
            return
        shape = moment.detection.shapes[0]
        if frame is None or frame.number in self._numbers or shape.age > 0 or not shape.ok:
            self.stale += 1
            return
        self.stale += any(frame.number in affected.get(kind, ()) for kind in ("drop", "freeze", "black"))
        self._numbers.add(frame.number)
        self.oldest = max(self.oldest, frame.received - frame.stamp)
        points, truth = frame.camera.to_base(shape.points3d), _At(self.robot.truth(frame.number))
        found = simulator_score(points, shape.valid, shape.layout, truth)
        off = np.linalg.norm(points - truth.truth(len(points)), axis=1)
        mm = 1e3 * float(off[shape.valid].mean())
        self.mm.append(mm)
        self.hidden.extend(1e3 * off[~shape.valid])
        slipped = found.slip > SLIP or found.flipped
        self.slips += slipped
        self.wrong += slipped or mm > _WRONG


class _At:
    """The truth at the time of a frame, with the method ``truth`` of a simulator."""

    def __init__(self, points: Array) -> None:
        along = arc_length(np.ascontiguousarray(points, np.float64))
        self._curve, self._length = CubicSpline(along, points), along[-1]

    def truth(self, n: int) -> Array:
        """Return (n, 3) equidistant points in metres, base frame."""
        return np.asarray(self._curve(np.linspace(0, self._length, n)))


def run(
    seconds: float = SECONDS,
    faults: Mapping[str, float] | None = None,
    *,
    seed: int = 0,
    renderer: str = "auto",
    progress: Callable[[str], object] = lambda text: None,
) -> tuple[Any, Seen]:
    """Run the loop.

    Args:
        seconds: Duration.
        faults: Arguments of ``SimulatedRobot.disturb``; None for a clean run.
        seed: Seed of the scene and of the faults.
        renderer: The simulator's renderer.
        progress: Called with the progress.

    Returns:
        The loop's report and the comparison with the truth.
    """
    import gymnasium as gym

    import shape_obs_envs  # noqa: F401 - registers the ids
    from shape_obs.deploy import Limits, Sway, deploy
    from shape_obs.wrappers import ShapeObservation
    from shape_obs_envs.robots import SimulatedRobot

    robot = SimulatedRobot(seed=seed, renderer=renderer, fps=_RATE)
    seen = Seen(robot)

    def step(moment: Any) -> None:
        if moment.step == 0 and faults is not None:
            robot.disturb(**faults, seed=seed)
        if moment.step % 30 == 0:
            progress(f"deploy: {moment.step / _RATE:.0f} of {seconds:.0f} s")
        seen.step(moment)

    env = gym.make("ShapeObs/D455-v0", source="robot", robot=robot, rate=_RATE, disable_env_checker=True)
    # A hand may stay for a second, after which the run has to continue.
    report = deploy(ShapeObservation(env), Sway(share=0.25), Limits(hold=5.0), seconds=seconds, on_step=step)
    return report, seen


def clean_targets(report: Any, seen: Seen) -> list[Row]:
    """Compare a clean run with its targets."""
    return [
        at_most("overruns", _OVERRUNS, 100 * report.overruns / report.steps, " %"),
        at_most("image to action, own share, 95th percentile", _OWN, report.sections["own"].p95, " ms"),
        at_most("mean error", 5.0, mean(seen.mm), " mm"),
        at_most("frames with an index slip", 0, seen.slips, ""),
        at_most("steps without an action", 0, report.held, ""),
    ]


def faulty_targets(report: Any, seen: Seen) -> list[Row]:
    """Compare a run with faults with its targets; rows without a target are for information."""
    hidden = mean(seen.hidden or [np.nan])
    return [
        at_most("wrong shapes that were acted on", 0, seen.wrong, ""),
        at_most("actions on a stale shape", 0, seen.stale, ""),
        at_most("mean error of what was acted on", 5.0, mean(seen.mm), " mm"),
        Row(what="mean error of the points that were reported hidden", asked="- mm", seen=hidden, reached="-"),
        Row(what="most seconds from an exposure to its arrival", asked="- s", seen=seen.oldest, reached="-"),
        Row(what="steps without an action", asked="-", seen=float(report.held), reached="-"),
    ]


def section_table(report: Any) -> list[Row]:
    """Return the milliseconds of each section of the loop."""
    return [Row(section=name, **section._asdict()) for name, section in report.sections.items()]
