"""How much the process grows while one detector sees frame after frame."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, Literal

from shape_obs.bench.asked import at_most
from shape_obs.bench.streams import BLUE, streams
from shape_obs.configurations import Centerline
from shape_obs.detector import ShapeDetector
from shape_obs.utils.threads import one_thread

MEMORY_WARM_UP: Final = 1_000  # frames after which the process is weighed first
SIZE: Final = (320, 240)
_SCENES: Final = 60  # played forwards and backwards
_LOST: Final = 200  # each time after so many frames the object is out of sight
_MEMORY_TARGET: Final = 5.0  # megabytes
_MEGABYTE: Final = 1e6


def memory_growth(
    frames: int,
    seed: int,
    *,
    backend: Literal["auto", "numpy", "numba"] = "auto",
    warm_up: int = MEMORY_WARM_UP,
    tick: Callable[[], Any] = lambda: None,
) -> float | None:
    """Megabytes by which the process grows while a detector follows a rope, loses it and finds it again.

    Args:
        frames: How many, RGB-D, 320 x 240.
        seed: Of motion, light and noise.
        backend: What the detector runs on.
        warm_up: Frames before, after which the process is weighed for the first time.
        tick: Called after each frame.

    Returns:
        None where the system does not tell a process's size.
    """
    scenes = [frame[SIZE] for frame in streams((SIZE,), _SCENES, seed)]
    scenes += scenes[-2:0:-1]
    gone = scenes[0]._replace(rgb=scenes[0].rgb[..., ::-1].copy())  # red instead of blue
    detector = ShapeDetector([Centerline(n=20)], BLUE, backend=backend)
    before: float | None = None
    with one_thread():
        for i in range(warm_up + frames):
            if i == warm_up:
                before = resident()
            detector.detect(*(gone if i % _LOST == _LOST - 1 else scenes[i % len(scenes)]))
            tick()
    after = resident()
    return None if before is None or after is None else after - before


def memory_claims(frames: int, grown: float | None) -> list[dict[str, Any]]:
    """What is asked of the memory, what was seen."""
    return [at_most(f"growth of the process over {frames} frames through one detector", _MEMORY_TARGET, grown, " MB")]


def resident() -> float | None:
    """Megabytes of memory that the process holds; None where the system does not tell."""
    gc.collect()
    table = Path("/proc/self/statm")
    if table.is_file():
        return int(table.read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE") / _MEGABYTE
    if sys.platform == "win32":
        return None
    import resource

    # The largest that it ever was: growth shows once it goes beyond. macOS counts bytes.
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _MEGABYTE
