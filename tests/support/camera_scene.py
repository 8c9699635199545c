"""Software cameras and images for the tests of cameras."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import cv2
import numpy as np
import pytest

from shape_obs.source import StaleFrame
from shape_obs_envs.sources import RealSenseSource, SoftwareD455
from shape_obs_envs.sources.realsense.driver import librealsense

try:
    librealsense()
except ImportError as error:
    pytest.skip(f"no librealsense: {error}", allow_module_level=True)

SMALL = {"width": 160, "height": 120}


def camera(serial: str = "455", **options: Any) -> SoftwareD455:
    """Return a small software camera."""
    return SoftwareD455(serial, **{**SMALL, **options})


def source(device: Any, **options: Any) -> RealSenseSource:
    """Return the source of a software camera."""
    return RealSenseSource(device, **{**SMALL, **options})


def picture(number: int = 0, size: tuple[int, int] = (120, 160)) -> tuple[np.ndarray, np.ndarray]:
    """Draw a raw pair that depends on its number: (H, W, 3) uint8 and (H, W) uint16."""
    rng = np.random.default_rng(number)
    return rng.integers(0, 256, (*size, 3), np.uint8), rng.integers(400, 900, size, np.uint16)


def smooth(size: tuple[int, int] = (480, 640)) -> tuple[np.ndarray, np.ndarray]:
    """Return an ideal pair that resampling leaves unchanged: soft colours, a flat table at 700 mm."""
    noise = np.random.default_rng(0).uniform(0, 255, (8, 10, 3)).astype(np.float32)
    rgb = cv2.resize(noise, size[::-1], interpolation=cv2.INTER_CUBIC).clip(0, 255).astype(np.uint8)
    return rgb, np.full(size, 700, np.uint16)


@contextmanager
def streaming(device: SoftwareD455, every: float = 0.01, count: float = math.inf) -> Iterator[None]:
    """Push frames into the camera from a separate thread."""
    over, raw = threading.Event(), picture()

    def run() -> None:
        while not over.wait(every) and device.push_raw(*raw) < count:
            pass

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def numbers(stream: RealSenseSource, count: int, timeout: float = 5.0, pause: float = 0.0) -> list[int | None]:
    """Return the numbers of the next frames."""
    found = []
    for _ in range(count):
        found.append(stream.read(timeout).number)
        time.sleep(pause)
    return found


def arrived(stream: RealSenseSource, number: int) -> None:
    """Wait until the source has this frame."""
    deadline = time.monotonic() + 10
    while time.monotonic() < deadline:
        with suppress(StaleFrame):
            if stream.read_latest(60).number == number:
                return
        time.sleep(0.002)
    raise AssertionError(f"frame {number} did not arrive")
