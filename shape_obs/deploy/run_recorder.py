"""Record the frames that a controller sees and what it does with them, in threads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from shape_obs.frame import Frame
from shape_obs.recording import Moment, Recorded, RecordingWriter, RobotInfo, Transition
from shape_obs.recording.format import plain
from shape_obs.recording.writer import check_new_folder
from shape_obs.robot import measured, robot_anchors, robot_name
from shape_obs.utils.errors import run_last

if TYPE_CHECKING:
    from typing_extensions import Self


class RunRecorder:
    """Write a recording of one or several runs, one episode each. Use it as a context manager.

    Threads encode the images. If they fall behind by ``pending`` frames, further frames are dropped and counted, and
    the loop goes on. Each frame is written with the number of its step, so readers notice where frames were dropped.

    Args:
        folder: A folder that does not exist or is empty.
        workers: Number of threads that encode images.
        pending: Largest number of frames that wait for the threads.

    Raises:
        FileExistsError: The folder is not empty.
        OSError: The folder cannot be made or written to.
    """

    def __init__(self, folder: str | Path, *, workers: int = 2, pending: int = 64) -> None:
        self._recorded = Recorded(Path(folder))
        check_new_folder(self._recorded.path)
        self._workers, self._pending = workers, pending
        self._writer: RecordingWriter | None = None
        self._robot: Any = None
        self._episode, self._last = -1, Transition(0)
        self._noted: Moment | None = None

    def begin(self, robot_env: Any) -> None:
        """Begin an episode, after the reset of ``ShapeObs/D455-v0``; the first one makes the folder.

        Raises:
            OSError: The folder cannot be written to.
        """
        self._robot, source = robot_env.robot, robot_env.source
        self._episode, self._last, self._noted = self._episode + 1, Transition(0), None
        robot_env.on_sent = self.write
        if self._writer is None:
            spec = self._robot.action_spec
            self._writer = RecordingWriter(
                self._recorded.path,
                source,
                depth=source.has_depth,
                workers=self._workers,
                pending=self._pending,
                robot=RobotInfo(robot_name(self._robot), spec.names, (*spec.names, *measured(self._robot)), spec),
            )

    def frame(self, frame: Frame | None, state: npt.ArrayLike) -> None:
        """Note a frame with the state of the robot, and the step that led to it; ``write`` writes it.

        Args:
            frame: The frame that the controller sees; None if there is none.
            state: ``(A,)`` state of the robot.
        """
        if frame is None:
            return
        anchors: Mapping[str, Sequence[float]] = dict(robot_anchors(self._robot))
        values = plain([*_flat(state), *measured(self._robot).values()])
        self._recorded.count(frame)
        self._noted = Moment(frame, anchors, self._episode, self._last, values)

    def write(self) -> None:
        """Hand the frame that was noted to the threads.

        The environment calls it after each action was sent: images are encoded while the loop waits for the next frame,
        and not while the controller computes.

        Raises:
            OSError: An earlier frame could not be written.
        """
        noted, self._noted = self._noted, None
        if noted is not None and self._writer is not None:
            self._recorded.dropped += not self._writer.add(noted, wait=False)

    def step(self, action: npt.ArrayLike | None, reward: Any, terminated: bool, truncated: bool) -> None:
        """Store what leads to the next frame: an action ``(A,)`` in -1 ... 1, or None where the robot stood still."""
        acted = None if action is None else plain(_flat(action))
        self._last = Transition(self._last.step + 1, acted, float(reward), bool(terminated), bool(truncated))

    def close(self) -> Recorded:
        """Wait until everything is written; further calls only return the outcome.

        Returns:
            The outcome. ``missed`` counts frames of the camera between the steps, which the controller never saw.

        Raises:
            OSError: A frame could not be written.
        """
        self.write()
        writer, recorded = self._writer, self._recorded
        if writer is not None:
            writer.close(missed=recorded.missed, dropped=recorded.dropped, stopped=recorded.stopped)
            recorded.frames, recorded.actions = writer.frames, writer.actions
        return recorded

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        run_last(error, self.close)


def _flat(values: npt.ArrayLike) -> list[Any]:
    return np.ravel(np.asarray(values)).tolist()
