"""Frames that no codec can compress, for tests of recordings, and an exact comparison of arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from fake_camera import FakeCamera

from shape_obs import Frame


def noise(count: int, size: tuple[int, int] = (48, 64), numbers: Sequence[int] | None = None) -> list[Frame]:
    """Return frames of random colours and depths."""
    draw = np.random.default_rng(0)
    return [
        Frame(
            draw.integers(0, 256, (*size, 3), np.uint8, endpoint=False),
            draw.integers(0, 65536, size, np.uint16, endpoint=False),
            stamp=i / 30,
            number=number,
        )
        for i, number in enumerate(numbers or range(count))
    ]


def camera_of(frames: Sequence[Frame], error: BaseException | None = None, *, live: bool = True) -> FakeCamera:
    """Return a camera of given frames, which ends with an error."""
    script = {} if error is None else {len(frames): lambda camera: camera.fail(error)}
    camera = FakeCamera(frames, script)
    camera.live = live
    return camera


def equal(a: Any, b: Any) -> bool:
    """Return whether two arrays are identical, or both None."""
    if a is None or b is None:
        return a is b
    return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
