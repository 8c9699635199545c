"""An arm in a process of its own, with its own clock, that outlives whoever drives it; and the driver for it.

The arm stands for the controller box of a real robot: it takes velocities with a time to live over the network, ends
each motion by itself, and notes when it moved. Run as a script, it needs the standard library alone.
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

    Messages are JSON: ``["move", velocity, seconds]``, ``["stop"]``, ``["mark"]`` (only noted), ``["notes"]``
    (answered with all notes since the last ``["clear"]``), ``["clear"]``, ``["quit"]``. Notes are ``[what, time]`` with
    ``time.monotonic()``: ``"move"``, ``"stop"`` and ``"mark"`` when these arrived, ``"still"`` when a motion ended.
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
    """Start the arm in a process and ask it what it did. A context manager."""

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
        self.tell("quit")
        self._process.wait(5.0)
        self._socket.close()

    def tell(self, *message: Any) -> None:
        """Send a message."""
        self._socket.send(json.dumps(message).encode())

    def notes(self) -> list[tuple[str, float]]:
        """Return what happened since the last ``clear``: (what, ``time.monotonic()``)."""
        self.tell("notes")
        return [(what, moment) for what, moment in json.loads(self._socket.recv(1 << 20))[0]]


class Arm:
    """Drive the arm: a robot with one coordinate, a velocity in metres per second.

    Args:
        port: Of the arm.

    Attributes:
        acknowledge: Seconds for which ``send`` waits, blocked in C, for an answer that never comes.
        delay: Seconds for which ``send`` is blocked before it passes the motion on.
    """

    name = "arm"

    def __init__(self, port: int) -> None:
        from shape_obs.robot import ActionSpec

        self.action_spec = ActionSpec(("x",), ("m",), (0.05,), (-10.0,), (10.0,), mode="velocity")
        self._socket, self._stopping = _connected(port), _connected(port)
        self._told = 0.0
        self.acknowledge = self.delay = 0.0

    def connect(self) -> None:
        """Do nothing: datagrams need no connection."""

    def reset(self) -> None:
        """Do nothing: the arm begins where it is."""

    def send(self, action: Any, until: float) -> None:
        """Begin a motion that the arm ends by itself."""
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
        """Have the arm note the time."""
        self._stopping.send(b'["mark"]')

    def state(self) -> Any:
        """Return a position: the arm has room enough."""
        import numpy as np

        return np.zeros(1)

    def stop(self) -> None:
        """Stop, through a connection of its own."""
        self._stopping.send(b'["stop"]')

    def park(self) -> None:
        """Stay: it may be left alone anywhere."""

    def disconnect(self) -> None:
        """Do nothing."""


def _connected(port: int) -> socket.socket:
    connection = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    connection.connect((_LOCAL, port))
    return connection


if __name__ == "__main__":
    run_arm(socket.socket(fileno=int(sys.argv[1])))
