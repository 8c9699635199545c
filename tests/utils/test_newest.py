"""A loop that hands its values to a thread never waits for it, and the newest value is not left out."""

from __future__ import annotations

import threading

from shape_obs.utils.threads import Newest


def test_values_that_come_while_it_works_replace_each_other():
    done: list[int] = []
    started, go = threading.Event(), threading.Event()

    def work(value: int) -> None:
        done.append(value)
        started.set()
        assert go.wait(10)

    thread = Newest(work, "test")
    thread.put(0)
    assert started.wait(10)
    for value in range(1, 6):
        thread.put(value)  # returns at once, though the work on 0 has not ended
    assert done == [0]
    go.set()
    assert thread.close(10)
    assert done == [0, 5], "the last value is worked on before the end"


def test_work_that_hangs_is_left_alone():
    never, started = threading.Event(), threading.Event()

    def work(_: int) -> None:
        started.set()
        never.wait(30)

    thread = Newest(work, "test")
    thread.put(0)
    assert started.wait(10)
    assert not thread.close(0.05)
    never.set()
    assert thread.close(10)
