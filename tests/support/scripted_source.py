"""A source of given frames, and frames that no codec can compress, for tests of recordings."""

from __future__ import annotations

from typing import Any

import numpy as np

from shape_obs import CameraModel, Frame, Intrinsics


class Script:
    """A source of given frames."""

    kind, name, live = "camera", "script", True
    camera: CameraModel | None = None
    intrinsics: Intrinsics | None = None

    def __init__(self, frames: list[Any], error: BaseException | None = None):
        self.frames, self.error = list(frames), error
        self.has_depth = self.frames[0].depth is not None
        self.left = iter(self.frames)

    def connect(self):
        pass

    def disconnect(self):
        pass

    def read(self, timeout=1.0, fresh=False):
        for frame in self.left:
            return frame
        assert self.error is not None
        raise self.error


def noise(count, size=(48, 64), numbers=None):
    """Return frames that no codec can compress."""
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


def equal(a: Any, b: Any) -> bool:
    """Return whether two arrays are identical, or both None."""
    if a is None or b is None:
        return a is b
    return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
