"""Start, control and end the simulation process from the robot's side."""

from __future__ import annotations

import contextlib
import multiprocessing
import queue
import threading
from collections.abc import Callable
from typing import Any, Final

from shape_obs.robot import RobotError
from shape_obs_envs.robots.frame_publisher import Captured, Failed, RawPair, SharedFrames, SimulationSpec, Started
from shape_obs_envs.robots.simulation_loop import run_simulation

#: Timeouts in seconds. A new process imports MuJoCo and compiles on its very first run.
_TO_START: Final = 120.0
_TO_RESTART: Final = 30.0
_TO_END: Final = 3.0


class SimulationProcess:
    """Run a simulation in its own process and receive its messages in a thread.

    Args:
        spec: Parameters of the simulation.
        on_frame: Called in that thread for each frame, with its images unless they were lost; they are overwritten
            after the call.

    Attributes:
        started: The first start of the simulation.

    Raises:
        RobotError: The simulation did not start.
    """

    def __init__(self, spec: SimulationSpec, on_frame: Callable[[Captured, RawPair | None], None]) -> None:
        context = multiprocessing.get_context("spawn")  # threads, OpenGL and librealsense do not survive a fork
        self._frames = SharedFrames(context, spec.geometry.colour.size, spec.geometry.depth.size)
        self._on_frame, self._failure = on_frame, ""
        self._starts: queue.Queue[Started | None] = queue.Queue()
        self._sending = threading.Lock()
        orders, self._orders = context.Pipe(duplex=False)
        self._messages, messages = context.Pipe(duplex=False)
        self._process = context.Process(
            target=run_simulation, args=(spec, self._frames, orders, messages), name="simulated robot", daemon=True
        )
        self._process.start()
        for end in (orders, messages):
            end.close()  # otherwise the end of the other process would go unnoticed
        self._receiver = threading.Thread(target=self._receive, name="simulated robot", daemon=True)
        self._receiver.start()
        try:
            self.started = self._next_start(_TO_START)
        except BaseException:  # also on Ctrl-C: no process may be left behind; raised again below
            self.close()
            raise

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid or 0

    @property
    def alive(self) -> bool:
        """Whether the process runs and its messages are received; its last messages may still be processed."""
        return self._process.is_alive() and self._receiver.is_alive()

    def order(self, order: str, what: Any = None) -> None:
        """Send an order; see ``SimulationLoop``.

        Raises:
            RobotError: The process has ended.
        """
        self.check()
        try:
            with self._sending:
                self._orders.send((order, what))
        except OSError as error:
            raise RobotError(self._end_message()) from error

    def restart(self, seed: int | None) -> Started:
        """Restart the simulation and wait for it.

        Raises:
            RobotError: The process has ended, or does not answer.
        """
        self.order("reset", seed)
        return self._next_start(_TO_RESTART)

    def check(self) -> None:
        """Check that the simulation runs.

        Raises:
            RobotError: The process has ended; the message contains the reason if it is known.
        """
        if not self.alive:
            raise RobotError(self._end_message())

    def close(self) -> None:
        """End process and thread, unless they have ended already."""
        with contextlib.suppress(RobotError):  # the process has ended
            self.order("end")
        for end in (lambda: None, self._process.terminate, self._process.kill):
            end()
            self._process.join(_TO_END)
            if not self._process.is_alive():
                break
        if threading.current_thread() is not self._receiver:
            self._receiver.join(_TO_END)
        for connection in (self._orders, self._messages):
            connection.close()

    def _receive(self) -> None:
        try:
            while True:
                message = self._messages.recv()
                if isinstance(message, Started):
                    self._starts.put(message)
                elif isinstance(message, Failed):
                    self._failure = message.reason
                elif message.slot is None:
                    self._on_frame(message, None)
                else:
                    self._on_frame(message, self._frames.get(message.slot))
                    self._frames.release()
        except (EOFError, OSError):
            pass  # the process has ended
        finally:
            self._starts.put(None)

    def _next_start(self, seconds: float) -> Started:
        try:
            started = self._starts.get(timeout=seconds)
        except queue.Empty:
            raise RobotError(
                f"The simulation (process {self.pid}) did not answer within {seconds:.0f} s: disconnect and connect."
            ) from None
        if started is None:
            self._receiver.join(_TO_END)
            raise RobotError(self._end_message())
        return started

    def _end_message(self) -> str:
        self._process.join(0.5)
        code = self._process.exitcode
        what = "its frames could not be published" if code is None else f"exit code {code}"
        reason = self._failure or f"{what}; see stderr"
        return f"The simulation has ended ({reason}): disconnect, and connect to start a new one."
