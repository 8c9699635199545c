"""SignalStop: stop a robot when the process is asked to end, whatever its main thread is doing.

Supervision: a robot is stopped, parked and disconnected however the work with it ends.
"""

from __future__ import annotations

import signal
import socket
import threading
import time
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from typing_extensions import Self
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import gymnasium as gym


#: Ctrl-C, systemd and docker, a terminal that was closed, Ctrl-\; and Ctrl-Break on Windows.
SIGNALS: Final = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGBREAK") if hasattr(signal, name)
)

_END: Final = 0  # no signal has this number

#: Seconds that the main thread waits at most for the robot to be stopped, before it goes on to end the run.
_PATIENCE: Final = 1.0


class Interrupted(KeyboardInterrupt):
    """A signal asked the process to end.

    Args:
        signum: Its number.

    Attributes:
        signum: As given.
        report: The report of the run that it ended; None if there is none.
    """

    def __init__(self, signum: int) -> None:
        super().__init__(f"interrupted by {signal.Signals(signum).name}")
        self.signum = signum
        self.report: Any = None


class SignalStop:
    """Call a function as soon as a signal asks the process to end, then raise ``Interrupted`` in the main thread.

    The function is called by a thread that waits for signals. Python runs signal handlers in the main thread and only
    between its own instructions, so a main thread that is blocked in a driver would never come to stop the robot.
    Within C code that holds Python's global lock no thread runs at all: there the robot's own time limit ends motions.

    The first signal raises in the main thread as soon as that runs Python code again. Later ones only call the function
    again, so that they do not interrupt an orderly end; ``raising`` lets the next one raise too.

    A signal that the process ignores, as SIGHUP under ``nohup``, stays ignored. Outside the main thread Python can set
    no handlers, and this does nothing. A context manager; it may be nested, and the innermost one acts.

    Args:
        stop: Stops the robot; called with the signal's name, from any thread.

    Attributes:
        received: Numbers of the signals that came, in their order.
        raising: Whether the next one raises in the main thread.
    """

    def __init__(self, stop: Callable[[str], None]) -> None:
        self._stop, self.raising = stop, True
        self.received: list[int] = []
        self._stops = 0

    def check(self) -> None:
        """Raise ``Interrupted`` if a signal came whose exception was lost, as in a destructor."""
        if self.received:
            self.raising = False
            raise Interrupted(self.received[0])

    def __enter__(self) -> Self:
        self._previous: dict[int, Any] = {}
        self._thread: threading.Thread | None = None
        if threading.current_thread() is not threading.main_thread():
            return self
        self._reading, self._writing = socket.socketpair()  # Windows wakes threads through sockets, not pipes
        self._writing.setblocking(False)
        self._outer = signal.set_wakeup_fd(self._writing.fileno(), warn_on_full_buffer=False)
        self._thread = threading.Thread(target=self._wait, name="signals", daemon=True)
        self._thread.start()
        for signum in SIGNALS:
            if signal.getsignal(signum) is not signal.SIG_IGN:
                self._previous[signum] = signal.signal(signum, self._handle)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._thread is None:
            return
        self.raising = False
        for signum, handler in self._previous.items():
            signal.signal(signum, signal.SIG_DFL if handler is None else handler)
        signal.set_wakeup_fd(self._outer)
        self._writing.send(bytes([_END]))
        self._thread.join()
        self._reading.close()
        self._writing.close()

    def _wait(self) -> None:
        """Call the function for each signal: Python's C handler writes its number into the socket at once."""
        while (signum := self._reading.recv(1)[0]) != _END:
            if signum in SIGNALS:  # others with a handler of their own come here too
                self._stop(signal.Signals(signum).name)
                self._stops += 1

    def _handle(self, signum: int, frame: FrameType | None) -> None:
        self.received.append(signum)
        # The robot is not parked or disconnected before the thread has stopped it. Without a lock, since one signal may
        # interrupt the handler of another.
        end = time.monotonic() + _PATIENCE
        while self._stops < len(self.received) and time.monotonic() < end:
            time.sleep(0.0005)
        if self.raising:
            self.raising = False
            raise Interrupted(signum)


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
