"""Interlock: allow motions only on recent images, and stop the robot from any thread."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from shape_obs.robot import Array, Robot, RobotError
from shape_obs.source import SourceError
from shape_obs.utils.errors import ending, message_of
from shape_obs.utils.timing import CLOCK, Clock

_LOG: Final = logging.getLogger(__name__)


class Interlock:
    """Check each motion on its way to the robot, and end it in time.

    A robot that is not connected is not stopped. What its driver raises becomes a ``RobotError`` that names the method.

    A motion is sent only before its time limit and while the interlock is not tripped. A thread stops the robot at the
    end of a motion that has not been replaced, even if the loop is blocked or the robot ignores ``until``.

    After a trip, by a signal, a watchdog or a person, no motion is sent until ``arm`` is called.

    Args:
        robot: The robot.
        clock: Time, and the thread that watches it.

    Attributes:
        connected: Whether the robot is connected.
        moved: Whether the robot may have been moved since it was connected.
        tripped: Why no motion is sent; empty while motions are allowed.
        expired: Number of motions that ended because they were not replaced in time.
    """

    connected: bool
    moved: bool
    tripped: str
    expired: int

    def __init__(self, robot: Robot, clock: Clock = CLOCK) -> None:
        self._robot, self._clock = robot, clock
        self.connected, self.moved, self.tripped, self.expired = False, False, "", 0
        self._stopped = True  # by a `stop` after which nothing was sent, even if that failed
        self._end = clock.alarm(self._expire, "motion end")
        self._failure: Exception | None = None

    def arm(self) -> None:
        """Allow motions again, at the start of a new episode."""
        self.tripped, self._failure = "", None

    def connect(self) -> None:
        """Allow motions again, and connect the robot unless it is connected; nothing moves.

        Raises:
            RobotError: The robot is not available.
        """
        self.arm()
        with _driver("connect"):
            self._robot.connect()
        if not self.connected:
            self.connected, self._stopped = True, False

    def state(self) -> Array:
        """Return the commanded position ``(A,)`` of the robot.

        Raises:
            RobotError: The robot cannot be reached.
        """
        with _driver("state"):
            return self._robot.state()

    def reset(self) -> None:
        """Send the robot to its start; robot and camera must be connected.

        Raises:
            RobotError: The robot cannot go there, or the interlock is tripped.
        """
        if self.tripped:
            raise RobotError(f"The robot was stopped before it went to its start: {self.tripped}.")
        self.moved, self._stopped = True, False
        with _driver("reset"):
            self._robot.reset()

    def park(self) -> None:
        """Send the robot to its safe pose, unless nothing has moved it since it was connected.

        Raises:
            RobotError: The robot cannot go there.
        """
        if self.moved:
            self._stopped = False
            with _driver("park"):
                self._robot.park()

    def send(self, motion: Array, until: float) -> str:
        """Send a motion, unless its time limit has passed or the interlock is tripped.

        Args:
            motion: Motion of shape ``(A,)`` in physical units.
            until: ``time.monotonic()`` in seconds at which it must end.

        Returns:
            Why the motion was not sent; empty if it was.

        Raises:
            RobotError: The robot cannot move, or an earlier stop failed.
        """
        self._raise_failure()
        refusal = self._refusal(until)
        if not refusal:
            self._end.set(until)
            self._stopped = False
            with _driver("send"):
                self._robot.send(motion, until)
            refusal = self._refusal(until)  # `send` may have been blocked, and may have moved the robot after all
        if refusal:
            self.stop()
        return refusal

    def stop(self) -> None:
        """Stop the robot; the next motion may follow.

        Raises:
            RobotError: The robot cannot be stopped.
        """
        self._end.set(math.inf)  # no motion is active
        self._stopped = True
        if self.connected:
            with _driver("stop"):
                self._robot.stop()
        self._raise_failure()

    def end(self) -> None:
        """Stop the robot unless this was tried since it was last sent anywhere; a motion ends by itself, too.

        Raises:
            RobotError: The robot cannot be stopped.
        """
        if self._stopped:
            self._raise_failure()
        else:
            self.stop()

    def trip(self, reason: str) -> None:
        """Stop the robot and refuse further motions. May be called by any thread; the next call raises its failure."""
        self.tripped = self.tripped or reason
        self._stop_robot()

    def close(self) -> None:
        """Disconnect the robot and end the thread; the next motion starts another one.

        Raises:
            RobotError: The robot cannot be disconnected.
        """
        self.connected = self.moved = False
        with ending(self._end.close), _driver("disconnect"):
            self._robot.disconnect()

    def _refusal(self, until: float) -> str:
        return self.tripped or ("image old" if self._clock.now() >= until else "")

    def _expire(self) -> None:
        """End a motion that was not replaced in time."""
        self.expired += 1
        self._stop_robot()

    def _stop_robot(self) -> None:
        """Stop the robot from a thread without a caller, and keep its error."""
        try:
            if self.connected:
                with _driver("stop"):
                    self._robot.stop()
        except Exception as error:  # noqa: BLE001 - raised by the next `send` or `stop`
            _LOG.error("The robot could not be stopped: %s", message_of(error))
            self._failure = error

    def _raise_failure(self) -> None:
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure


@contextmanager
def _driver(method: str) -> Iterator[None]:
    """Turn what a robot's driver raises into a ``RobotError`` that names the method."""
    try:
        yield
    except (RobotError, SourceError, ValueError):
        raise
    except Exception as error:
        raise RobotError(f"robot.{method}: {type(error).__name__}: {message_of(error)}") from error
