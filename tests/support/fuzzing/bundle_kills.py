"""Processes that are killed while they save a bundle over another one."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import gymnasium as gym
import numpy as np

from shape_obs import load_bundle, save_bundle

#: Wide, so that writing the file takes a large part of saving it: about 10 MB.
_LAYERS: Final = [512, 512]
_ATTEMPTS: Final = 8
_SAVES: Final = 3
#: Seconds that writing takes, and that it is waited for.
_WRITING: Final = 0.004
_LONGEST: Final = 30.0


def kill_savers(folder: Path, kills: int, seed: int) -> dict[str, int]:
    """Save several versions of a bundle, then kill forked processes that replace one by the other.

    Every second instant is drawn from the whole of saving, the others from the writing of the file; of those, one that
    came too late is followed by another kill.

    Args:
        folder: An empty one.
        kills: How many processes are killed.
        seed: Of the instants.

    Returns:
        ``broken``: kills after which the file was neither version. ``unread``: after which it did not load.
        ``writing``: that left a temporary file, since they hit the writing. ``left``: temporary files in the end.
    """
    import stable_baselines3 as sb3
    import torch

    torch.set_num_threads(1)
    env = gym.make("BundleForeign-v0", disable_env_checker=True)
    model = sb3.SAC("MlpPolicy", env, policy_kwargs={"net_arch": _LAYERS}, buffer_size=10, seed=0, device="cpu")
    path = folder / "cable.policy"

    def save(version: int) -> None:
        save_bundle(model, env, path, summary={"version": version})

    versions, start = [], time.monotonic()
    for version in range(_SAVES):
        save(version)
        versions.append(path.read_bytes())
    lasting = (time.monotonic() - start) / _SAVES
    rng = np.random.default_rng(seed)
    seen = {"broken": 0, "unread": 0, "writing": 0, "left": 0}
    for number in range(kills):
        before = len(os.listdir(folder))
        for _ in range(_ATTEMPTS if number % 2 == 0 else 1):
            if number % 2:
                _kill(save, lambda: None, float(rng.uniform(0, _SAVES * lasting)))
            else:
                _kill(save, lambda before=before: _until_written(folder, before), float(rng.uniform(0, _WRITING)))
            seen["broken"] += not path.is_file() or path.read_bytes() not in versions
            try:
                load_bundle(path)
            except (OSError, ValueError):
                seen["unread"] += 1
            if len(os.listdir(folder)) > before:
                seen["writing"] += 1
                break
    seen["left"] = len(list(folder.iterdir())) - 1
    return seen


def _kill(save: Callable[[int], None], wait: Callable[[], None], delay: float) -> None:
    """Fork a process that saves one version after the other, wait, and kill it ``delay`` seconds later."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        with contextlib.suppress(BaseException):
            os.write(writing, b"x")
            while True:
                for version in range(_SAVES):
                    save(version)
        os._exit(1)
    os.close(writing)
    select.select([reading], [], [])
    wait()
    time.sleep(delay)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    os.close(reading)


def _until_written(folder: Path, before: int) -> None:
    """Wait until a process has begun to write its file."""
    start = time.monotonic()
    while len(os.listdir(folder)) <= before and time.monotonic() < start + _LONGEST:
        time.sleep(0.0005)
