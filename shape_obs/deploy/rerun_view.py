"""Log a running robot to rerun: what the camera sees, the shapes, the goals, and the loop's decisions."""

from __future__ import annotations

from typing import Any

from shape_obs.deploy.loop import Step
from shape_obs.drawing.rerun_log import RerunLog
from shape_obs.utils.threads import Newest


class RerunView:
    """Log the steps of a loop to a rerun recording stream, as ``log_rerun`` does, with actions, goals and decisions.

    A thread logs only the newest step, so that the loop never waits: while it is busy, steps are left out.

    Args:
        recording: The ``rerun.RecordingStream``.
        env: The running environment, with a robot; if it has goals, its ``targets`` are logged too.

    Raises:
        ImportError: rerun is not installed; the extra ``rerun`` installs it.
    """

    def __init__(self, recording: Any, env: Any) -> None:
        self._log = RerunLog(recording)
        self._env = env
        self._names: tuple[str, ...] = env.unwrapped.robot.action_spec.names
        self._newest: Newest[Step] = Newest(self._draw, "rerun view")

    def show(self, step: Step) -> None:
        """Log a step next, in place of one that has not been logged yet."""
        self._newest.put(step)

    def close(self) -> None:
        """Log the last step; a viewer that hangs is left alone after two seconds."""
        self._newest.close()

    def _draw(self, step: Step) -> None:
        frame, judgement = step.frame, step.judgement
        notes = {"loop": f"{judgement.move} {judgement.reason}".strip()}
        if frame is None:
            self._log.log(None, number=step.step, notes=notes)
            return
        action = {} if step.action is None else {"action": dict(zip(self._names, step.action, strict=True))}
        targets = getattr(self._env, "targets", ())
        goals = [target.points2d for target in targets if target.points2d is not None]
        self._log.log(
            step.detection,
            frame.rgb,
            frame.depth,
            frame.camera,
            number=step.step,
            features=action,
            goals=goals,
            notes=notes,
        )
