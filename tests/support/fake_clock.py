"""A clock that moves when someone waits for it, so that tests of deadlines take no time and are exact."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable

from shape_obs.utils.timing import Alarm, Clock


class FakeAlarm(Alarm):
    """An alarm that the fake clock rings, in the thread that waits."""

    def __init__(self, act: Callable[[], object], name: str) -> None:
        self.act, self.name, self.due = act, name, math.inf

    def set(self, due: float) -> None:
        self.due = due

    def close(self) -> None:
        self.due = math.inf


class FakeClock(Clock):
    """Time that passes only in ``sleep`` and ``wait``, which return at once; alarms that are due ring meanwhile.

    Attributes:
        time: Present time in seconds.
    """

    def __init__(self) -> None:
        self.time = 1000.0
        self._alarms: list[FakeAlarm] = []

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float) -> None:
        end = self.time + max(seconds, 0.0)
        while due := [alarm for alarm in self._alarms if alarm.due <= end]:
            first = min(due, key=lambda alarm: alarm.due)
            self.time, first.due = max(self.time, first.due), math.inf
            first.act()
        self.time = max(self.time, end)

    def wait(self, condition: threading.Condition, seconds: float | None) -> None:
        if seconds is None:
            condition.wait()
        else:
            self.sleep(seconds)

    def alarm(self, act: Callable[[], object], name: str) -> Alarm:
        self._alarms.append(FakeAlarm(act, name))
        return self._alarms[-1]
