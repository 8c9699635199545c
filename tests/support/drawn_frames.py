"""A recording of frames that a test has drawn, and the command line as a test calls it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from noise_frames import camera_of

from shape_obs import CameraModel, Frame, Intrinsics
from shape_obs.cli import main
from shape_obs.recording import record


def record_drawn(folder: Path, images: Sequence[Any], intrinsics: Intrinsics, depths: Sequence[Any] = ()) -> None:
    """Record images, with depths if there are any."""
    pairs = zip(images, depths or [None] * len(images), strict=True)
    frames = [Frame(rgb, depth, CameraModel(intrinsics), stamp=i / 30) for i, (rgb, depth) in enumerate(pairs)]
    record(camera_of(frames, live=False), folder)


def run(*words: object) -> int:
    with pytest.raises(SystemExit) as end:
        main([str(word) for word in words])
    return int(end.value.code or 0)
