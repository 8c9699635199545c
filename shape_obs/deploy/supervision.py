"""Supervision: a robot is stopped, parked and disconnected however the work with it ends."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

from shape_obs.deploy.signals import SignalStop

if TYPE_CHECKING:
    import gymnasium as gym


@contextmanager
def supervised(env: gym.Env[Any, Any], *, park: bool = True, close: bool = True) -> Iterator[SignalStop]:
    """Stop the robot at once on a signal; in the end stop it, park it and disconnect it, whatever happened.

    Each of these is done even if the one before fails. A second signal skips parking, or ends it.

    Args:
        env: ``ShapeObs/D455-v0`` with a robot, wrapped or not.
        park: Whether to send the robot to its safe pose in the end.
        close: Whether to disconnect camera and robot in the end.

    Raises:
        Interrupted: SIGINT, SIGTERM, SIGHUP or SIGQUIT came; raised when the robot has been stopped and parked.
        RobotError: The robot cannot be stopped or parked.
    """
    cell: Any = env.unwrapped
    with SignalStop(cell.interlock.trip) as signals:
        with ExitStack() as end:
            # In reverse: stop, park, disconnect.
            if close:
                end.callback(env.close)
            if park:
                end.callback(_park, cell, signals)
            end.callback(cell.interlock.stop)
            try:
                yield signals
            finally:
                signals.raising = False
        signals.check()


def _park(cell: Any, signals: SignalStop) -> None:
    if len(signals.received) > 1:
        return
    signals.raising = True  # parking is a motion, and may take long
    try:
        cell.robot.park()
    finally:
        signals.raising = False
