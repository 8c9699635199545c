"""Stop a robot as soon as a signal asks the process to end, and park and disconnect it however the work ends."""

from __future__ import annotations

import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any, Final

from shape_obs.utils.errors import Interrupted, add_later, ending

if TYPE_CHECKING:
    import gymnasium as gym
    from typing_extensions import Self

#: Sent by Ctrl-C, systemd and docker, a closed terminal, Ctrl-\, and Ctrl-Break on Windows.
SIGNALS: Final = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGBREAK") if hasattr(signal, name)
)
_HANGUP: Final = getattr(signal, "SIGHUP", None)
_END: Final = 0  # no signal has this number
#: Longest time in seconds that the main thread waits until the robot is stopped, before it ends the run.
_PATIENCE: Final = 1.0


class SignalStop:
    """Call a function as soon as a signal asks the process to end, then raise ``Interrupted`` in the main thread.

    A thread waits for signals and calls the function. Python runs signal handlers only in the main thread, between
    Python instructions, so a main thread that is blocked in a driver would not stop the robot. While C code holds
    Python's global lock, no thread can run; the robot's own time limit then ends motions.

    The first signal raises in the main thread as soon as that runs Python code again. Later signals only call the
    function, so that they do not interrupt an orderly end; ``raising`` makes the next signal raise too.

    A shell starts jobs in the background with SIGINT and SIGQUIT ignored; they stop the robot all the same. An ignored
    SIGHUP stays ignored: ``nohup`` asks to go on when the terminal is closed. Outside the main thread, Python cannot
    set handlers, and this does nothing. Use it as a context manager; of nested ones, the innermost acts.

    Args:
        stop: Stops the robot; called with the name of the signal, from any thread.

    Attributes:
        received: Numbers of the received signals, in order.
        raising: Whether the next signal raises in the main thread.
    """

    def __init__(self, stop: Callable[[str], None]) -> None:
        self._stop, self.raising = stop, True
        self.received: list[int] = []
        self._stops = 0

    def check(self) -> None:
        """Raise ``Interrupted`` if a signal came and its exception was lost, for example in a destructor."""
        if self.received:
            self.raising = False
            raise Interrupted(self.received[0])

    @contextmanager
    def unmasked(self) -> Iterator[None]:
        """Raise ``Interrupted`` again if a signal came and the block ends with another error.

        A driver may turn the exception of a signal into another one. A compiled function calls some Python to build
        the arrays that it returns; an exception there comes out as a ``SystemError`` of the function.
        """
        try:
            yield
        except Exception as error:
            if not self.received:
                raise
            self.raising = False
            interrupted = Interrupted(self.received[0])
            if not isinstance(error, SystemError) and str(interrupted) not in str(error):
                add_later(interrupted, error)
            raise interrupted from error

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
            if signum != _HANGUP or signal.getsignal(signum) is not signal.SIG_IGN:
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
        """Call the function for each signal, whose number Python's C handler writes into the socket at once."""
        while (signum := self._reading.recv(1)[0]) != _END:
            if signum in SIGNALS:  # signals with another handler are also written
                self._stop(signal.Signals(signum).name)
                self._stops += 1

    def _handle(self, signum: int, frame: FrameType | None) -> None:
        self.received.append(signum)
        # Wait until the thread has stopped the robot, before the main thread parks or disconnects it. Not with a lock,
        # since a signal may interrupt the handler of another one.
        end = time.monotonic() + _PATIENCE
        while self._stops < len(self.received) and time.monotonic() < end:
            time.sleep(0.0005)
        if self.raising:
            self.raising = False
            raise Interrupted(signum)


@contextmanager
def supervised(env: gym.Env[Any, Any], *, park: bool = True, close: bool = True) -> Iterator[SignalStop]:
    """Stop the robot at once on a signal; at the end stop, park and disconnect it, also after an error.

    Each of these is done even if the previous one fails; the first error is raised, with the others as its notes. A
    robot that nothing has moved yet is not parked. A second signal skips or ends parking.

    Args:
        env: ``ShapeObs/D455-v0`` with a robot, wrapped or not.
        park: Whether to send the robot to its safe pose at the end.
        close: Whether to disconnect camera and robot at the end.

    Raises:
        Interrupted: SIGINT, SIGTERM, SIGHUP or SIGQUIT came; raised after the robot was stopped and parked.
        RobotError: The robot cannot be stopped or parked.
    """
    interlock = env.unwrapped.interlock  # pyright: ignore[reportAttributeAccessIssue]
    steps: list[Callable[[], object]] = [interlock.end]
    with SignalStop(interlock.trip) as signals:
        if park:
            steps.append(lambda: _park(interlock, signals))
        if close:
            steps.append(env.close)
        with signals.unmasked(), ending(*steps):
            try:
                with signals.unmasked():
                    yield signals
            finally:
                signals.raising = False
        signals.check()


def _park(interlock: Any, signals: SignalStop) -> None:
    if len(signals.received) > 1:
        return
    signals.raising = True  # parking is a motion, which may take long
    try:
        interlock.park()
    finally:
        signals.raising = False
