"""A simulated arm that runs in a separate process with its own clock, and its driver.

Like the controller of a real robot, the arm takes velocities with a time to live over the network, ends each motion by
itself, and records when it moved. As a script it needs only the standard library.
"""

from __future__ import annotations

import json
import select
import socket
import subprocess
import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from typing_extensions import Self

_TICK: Final = 0.0005  # seconds
_LOCAL: Final = "127.0.0.1"


def run_arm(box: socket.socket) -> None:
    """Control the arm until it is asked to quit.

    Messages are JSON: ``["move", velocity, seconds]``, ``["stop"]``, ``["mark"]`` (only recorded), ``["notes"]``
    (answered with all notes since the last ``["clear"]``), ``["clear"]``, ``["quit"]``. Notes are ``[what, time]`` with
    ``time.monotonic()``: ``"move"``, ``"stop"`` and ``"mark"`` when they arrived, ``"still"`` when a motion ended.
    """
    notes: list[tuple[str, float]] = []
    end, position, ticked = 0.0, 0.0, time.monotonic()
    velocity = 0.0
    while True:
        ready, _, _ = select.select([box], [], [], _TICK if velocity else None)
        now = time.monotonic()
        position += velocity * (now - ticked)
        ticked = now
        if velocity and now >= end:
            velocity = 0.0
            notes.append(("still", now))
        if not ready:
            continue
        data, sender = box.recvfrom(65536)
        what, *values = json.loads(data)
        if what == "quit":
            return
        if what == "clear":
            notes = []
        elif what == "notes":
            box.sendto(json.dumps([notes, position]).encode(), sender)
        else:
            notes.append((what, now))
        if what == "move" and values[1] > 0:
            velocity, end = values[0], now + values[1]
        elif what == "stop" and velocity:
            velocity = 0.0
            notes.append(("still", now))


class ArmProcess:
    """Run the arm in a process, as a context manager, and read its notes."""

    def __enter__(self) -> Self:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as box:
            box.bind((_LOCAL, 0))
            self.port = int(box.getsockname()[1])
            self._process = subprocess.Popen(
                [sys.executable, "-I", __file__, str(box.fileno())], pass_fds=[box.fileno()]
            )
        self._socket = _connected(self.port)
        self._socket.settimeout(5.0)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.send_message("quit")
        self._process.wait(5.0)
        self._socket.close()

    def send_message(self, *message: Any) -> None:
        """Send a message."""
        self._socket.send(json.dumps(message).encode())

    def notes(self) -> list[tuple[str, float]]:
        """Return what happened since the last ``clear``: (what, ``time.monotonic()``)."""
        self.send_message("notes")
        return [(what, moment) for what, moment in json.loads(self._socket.recv(1 << 20))[0]]


class Arm:
    """Drive the arm: a robot with one coordinate, a velocity in metres per second.

    Args:
        port: Port of the arm.

    Attributes:
        acknowledge: Seconds for which ``send`` waits, blocked in C, for an answer that never comes.
        delay: Seconds for which ``send`` is blocked before it sends the motion.
    """

    name = "arm"

    def __init__(self, port: int) -> None:
        from shape_obs.robot import ActionSpec

        self.action_spec = ActionSpec(("x",), ("m",), (0.05,), (-10.0,), (10.0,), mode="velocity")
        self._socket, self._stopping = _connected(port), _connected(port)
        self.acknowledge = self.delay = 0.0

    def connect(self) -> None:
        """Do nothing; datagrams need no connection."""

    def reset(self) -> None:
        """Do nothing; the arm starts where it is."""

    def send(self, action: Any, until: float) -> None:
        """Start a motion that the arm ends by itself."""
        time.sleep(self.delay)
        left = until - time.monotonic()
        if left > 0:
            self._socket.send(json.dumps(["move", float(action[0]), left]).encode())
        if self.acknowledge:
            self._socket.settimeout(self.acknowledge)
            try:
                self._socket.recv(1)
            except TimeoutError:
                self.acknowledge = 0.0

    def mark(self) -> None:
        """Make the arm record the time."""
        self._stopping.send(b'["mark"]')

    def state(self) -> Any:
        """Return a position; the arm has no limits."""
        import numpy as np

        return np.zeros(1)

    def stop(self) -> None:
        """Stop, through a separate connection."""
        self._stopping.send(b'["stop"]')

    def park(self) -> None:
        """Do nothing; any position is safe."""

    def disconnect(self) -> None:
        """Do nothing."""


def _connected(port: int) -> socket.socket:
    connection = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    connection.connect((_LOCAL, port))
    return connection


if __name__ == "__main__":
    run_arm(socket.socket(fileno=int(sys.argv[1])))
