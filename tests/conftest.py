"""One thread for every library, and the scenes that several tests share."""

# ruff: noqa: E402

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
# Ray reads it on import. Under `uv run` it would build an environment for its workers, without the test's modules.
os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")

# For rope_env and goal_envs, which tests and the worker processes that they start import.
sys.path.insert(0, str(Path(__file__).parent / "support"))

import cv2
import numpy as np
import pytest
from hypothesis import settings

from shape_obs import CameraModel, Intrinsics
from shape_obs.bench.scenes import Rope, draw_rope
from tests.detection_contract import watched

cv2.setNumThreads(1)
settings.register_profile("shape_obs", deadline=None, max_examples=30, derandomize=True)
settings.load_profile("shape_obs")


@pytest.fixture
def default_signals() -> Iterator[None]:
    """Treat signals as a shell's job in the foreground does: one in the background inherits that some are ignored."""
    defaults = {
        "SIGINT": signal.default_int_handler, "SIGTERM": signal.SIG_DFL, "SIGQUIT": signal.SIG_DFL,
        "SIGHUP": signal.SIG_DFL,
    }  # fmt: skip
    numbers = {getattr(signal, name): handler for name, handler in defaults.items() if hasattr(signal, name)}
    before = {number: signal.signal(number, handler) for number, handler in numbers.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Return a function that runs ``shape-obs ARGUMENTS`` and returns exit code, stdout and stderr."""
    from shape_obs.cli import main

    def run(*arguments: object) -> tuple[int, str, str]:
        capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        assert isinstance(stop.value.code, int)
        return stop.value.code, captured.out, captured.err

    return run


@pytest.fixture(scope="session")
def broken_promises() -> Iterator[list[str]]:
    """Hold every detection of the session against the contract; return what was broken so far."""
    with watched() as broken:
        yield broken


@pytest.fixture(autouse=True)
def _every_detection_keeps_its_promises(broken_promises: list[str]) -> Iterator[None]:
    yield
    found = broken_promises[:]
    broken_promises.clear()
    assert not found, f"detections of this test break the contract of tests/detection_contract.py: {found[:5]}"


@pytest.fixture(scope="session")
def wave() -> Rope:
    """Return a wavy rope from (50, 140) to the right, 10 px thick, with flat ends, in 320 x 240 pixels."""
    u = np.linspace(50, 270, 400)
    return draw_rope(np.stack([u, 140 + 40 * np.sin((u - 50) / 40)], axis=1), 10.0, size=(240, 320))


@pytest.fixture(scope="session")
def intrinsics() -> Intrinsics:
    """Return the intrinsics of a pinhole camera of 320 x 240 pixels."""
    return Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5)


@pytest.fixture(scope="session")
def overhead(intrinsics: Intrinsics) -> CameraModel:
    """Return a camera one metre above the base frame's origin that looks down, with image right along base x."""
    return CameraModel(intrinsics, np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 1], [0, 0, 0, 1]]))


@pytest.fixture(scope="session")
def blue(wave: Rope) -> np.ndarray:
    """Return an image of the wavy rope in blue on gray, (240, 320, 3) uint8."""
    return np.where(wave.mask[..., None] > 0, np.array([30, 60, 200]), np.array([150, 150, 150])).astype(np.uint8)
