"""Link: the process in which a world runs, from the side of who started it."""

from __future__ import annotations

import contextlib
import multiprocessing
import queue
import threading
from collections.abc import Callable
from typing import Any, Final

from shape_obs.robot import RobotError
from shape_obs_envs.robots.slots import Pictures, Slots
from shape_obs_envs.robots.world import Failed, Plan, Shot, Started, run_world

#: Seconds. A new process imports MuJoCo and, the very first time, compiles.
_TO_START: Final = 120.0
_TO_RESTART: Final = 30.0
_TO_END: Final = 3.0


class Link:
    """Starts a world in a process of its own, and hears from it in a thread.

    Args:
        plan: What is to be simulated.
        on_shot: Called in that thread for each picture, with its images where there are any; they are overwritten
            after the call.

    Attributes:
        started: The first start of the world.

    Raises:
        RobotError: It did not start; the message says why.
    """

    def __init__(self, plan: Plan, on_shot: Callable[[Shot, Pictures | None], None]) -> None:
        context = multiprocessing.get_context("spawn")  # threads, OpenGL and librealsense do not survive a fork
        self._slots = Slots(context, plan.geometry.colour.size, plan.geometry.depth.size)
        self._on_shot, self._failure = on_shot, ""
        self._starts: queue.Queue[Started | None] = queue.Queue()
        self._sending = threading.Lock()
        orders, self._orders = context.Pipe(duplex=False)
        self._notices, notices = context.Pipe(duplex=False)
        self._process = context.Process(
            target=run_world, args=(plan, self._slots, orders, notices), name="simulated robot", daemon=True
        )
        self._process.start()
        for end in (orders, notices):
            end.close()  # or nobody would see that the other side is gone
        self._pump = threading.Thread(target=self._hear, name="simulated robot", daemon=True)
        self._pump.start()
        try:
            self.started = self._next_start(_TO_START)
        except BaseException:
            self.close()
            raise

    @property
    def pid(self) -> int:
        """The process's number."""
        return self._process.pid or 0

    @property
    def alive(self) -> bool:
        """Whether the world runs and is heard; its end is known at once, though what it last said may still be read."""
        return self._process.is_alive() and self._pump.is_alive()

    def order(self, order: str, what: Any = None) -> None:
        """Send an order; see `World`.

        Raises:
            RobotError: The process is gone.
        """
        self.check()
        try:
            with self._sending:
                self._orders.send((order, what))
        except OSError as error:
            raise RobotError(self._why()) from error

    def restart(self, seed: int | None) -> Started:
        """Have the world start anew, and wait for it.

        Raises:
            RobotError: The process is gone, or does not answer.
        """
        self.order("reset", seed)
        return self._next_start(_TO_RESTART)

    def check(self) -> None:
        """See whether the world runs.

        Raises:
            RobotError: The process is gone; the message says why, as far as it is known.
        """
        if not self.alive:
            raise RobotError(self._why())

    def close(self) -> None:
        """End process and thread; nothing happens when they have ended already."""
        with contextlib.suppress(OSError, RobotError):
            self.order("end")
        for end in (lambda: None, self._process.terminate, self._process.kill):
            end()
            self._process.join(_TO_END)
            if not self._process.is_alive():
                break
        if threading.current_thread() is not self._pump:
            self._pump.join(_TO_END)
        for connection in (self._orders, self._notices):
            connection.close()

    def _hear(self) -> None:
        try:
            while True:
                notice = self._notices.recv()
                if isinstance(notice, Started):
                    self._starts.put(notice)
                elif isinstance(notice, Failed):
                    self._failure = notice.reason
                elif notice.slot is None:
                    self._on_shot(notice, None)
                else:
                    self._on_shot(notice, self._slots.get(notice.slot))
                    self._slots.release()
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
            self._pump.join(_TO_END)
            raise RobotError(self._why())
        return started

    def _why(self) -> str:
        """Why the process ended."""
        self._process.join(0.5)
        code = self._process.exitcode
        what = "its pictures could not be passed on" if code is None else f"exit code {code}"
        reason = self._failure or f"{what}; see stderr"
        return f"The simulation has ended ({reason}): disconnect, and connect to start a new one."
