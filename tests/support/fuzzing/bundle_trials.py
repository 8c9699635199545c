"""Read bundles in separate processes, and kill processes that save one.

``python -m fuzzing.bundle_trials FOLDER KILLS`` reads ``FOLDER/files/*``, ``*.trusted`` with ``trust=True``,
and prints a line of JSON for each and one for the kills. It has loaded all libraries and forks for each file, so that
time and memory are those of the file alone.
"""

from __future__ import annotations

import gc
import importlib
import json
import multiprocessing
import os
import re
import resource
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import gymnasium as gym
import numpy as np
from bundles import cable
from fake_cell import make_env

from fuzzing.hostile_bundles import VARIABLE
from shape_obs import load_bundle, save_bundle
from shape_obs.deploy.policy_bundle import BundleError
from shape_obs.deploy.policy_bundle.spaces import space_from_dict, zeros

#: Seconds after which a process is ended, and bytes of addresses beyond those of its parent.
_LONGEST: Final = 20.0
_MOST: Final = 2**30
_FORK: Final = multiprocessing.get_context("fork")


class Foreign(gym.Env[Any, Any]):
    """An environment of another package, which takes code and sizes from its arguments."""

    observation_space = gym.spaces.Box(-1.0, 1.0, (3,), np.float32)
    action_space = gym.spaces.Box(-1.0, 1.0, (2,), np.float32)

    def __init__(self, plugin: Any = None, size: int = 1) -> None:
        if plugin is not None:
            importlib.import_module(re.split(r"[:.]", re.sub(r"^\W+", "", str(plugin)))[0])
        self.memory = np.ones(size, np.int64)


def main(folder: Path, kills: int) -> None:
    """Read all files of a folder, then kill processes that save one."""
    import torch

    torch.set_num_threads(1)
    gym.register("BundleForeign-v0", f"{Foreign.__module__}:{Foreign.__name__}")
    gym.logger.min_level = gym.logger.ERROR
    warnings.simplefilter("ignore")
    attempt(folder / "sample.policy", folder)  # what is loaded on first use
    importlib.import_module("torch._dynamo")  # PyTorch's own, for policies with a CNN or PPO
    gc.freeze()  # collecting in a fork would copy all of the parent's memory
    for path in sorted((folder / "files").iterdir()):
        print(json.dumps(in_fork(lambda path=path: attempt(path, folder))), flush=True)
    with tempfile.TemporaryDirectory(dir=folder) as saved:
        print(json.dumps(kill_savers(Path(saved), kills)), flush=True)


def attempt(path: Path, folder: Path) -> dict[str, Any]:
    """Load a file and, where that works, act, rebuild its environment and wrap another one.

    Returns:
        ``undeclared`` (errors that no docstring names), ``code`` (whether the canary's code ran), ``left`` (number of
        files in the temporary folder), ``seconds`` and ``mb``.
    """
    canary, undeclared = Path(os.environ[VARIABLE]), list[str]()
    canary.unlink(missing_ok=True)

    def tried(call: Callable[[], Any], *declared: type[Exception]) -> Any:
        try:
            return call()
        except declared:
            return None
        except Exception as error:  # noqa: BLE001 - undeclared exceptions are what is looked for
            undeclared.append(f"{type(error).__name__}: {error}"[:300])

    def use() -> None:
        bundle = tried(lambda: load_bundle(path, trust=path.suffix == ".trusted"), BundleError)
        if bundle is None:
            return
        tried(lambda: bundle.act(zeros(space_from_dict(bundle.record.observation_space, "observation"))))
        env = tried(bundle.make_env, BundleError, ImportError)
        if env is not None:
            env.close()
        tried(lambda: bundle.wrap(make_env()), BundleError, ValueError)

    with tempfile.TemporaryDirectory(dir=folder) as temporary:
        tempfile.tempdir = temporary
        before, start = _memory(), time.perf_counter()
        use()
        seconds, grown = time.perf_counter() - start, _memory() - before
        gc.collect()  # a bundle's temporary folder goes with it
        left, tempfile.tempdir = len(os.listdir(temporary)), None
    return {"undeclared": undeclared, "code": canary.exists(), "left": left, "seconds": seconds, "mb": grown}


def in_fork(work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Return what work returns in a forked process with limited memory and time; a process may die or hang."""
    reading, writing = _FORK.Pipe(duplex=False)

    def limited() -> None:
        most = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize() + _MOST
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
        writing.send(work())

    child = _FORK.Process(target=limited)
    child.start()
    writing.close()
    try:
        if reading.poll(_LONGEST):
            return reading.recv()
    except EOFError:
        pass
    finally:
        child.kill()
        child.join()
    return {"undeclared": ["died or hung"], "code": False, "left": 0, "seconds": _LONGEST, "mb": 0.0}


def kill_savers(folder: Path, kills: int) -> dict[str, int]:
    """Save versions of a bundle, then kill processes that replace one by another.

    Every second kill comes at any instant, the others while the file is written.

    Returns:
        ``lost``: kills after which the file was neither version or did not load. ``writing``: those that left a
        temporary file. ``left``: temporary files in the end.
    """
    import stable_baselines3 as sb3

    options = {"buffer_size": 10, "device": "cpu", "policy_kwargs": {"net_arch": [512, 512]}}  # wide: long to write
    model = sb3.SAC("MultiInputPolicy", cable(), **options)
    env, path, draw = model.get_env(), folder / "cable.policy", np.random.default_rng(0)

    def save(version: int) -> None:
        save_bundle(model, env, path, summary={"version": version})

    def save_on() -> None:
        while True:
            for version in range(2):
                save(version)

    versions, start = list[bytes](), time.monotonic()
    for version in range(2):
        save(version)
        versions.append(path.read_bytes())
    lasting, seen = time.monotonic() - start, {"lost": 0, "writing": 0, "left": 0}
    for number in range(kills):
        before = len(os.listdir(folder))
        child = _FORK.Process(target=save_on)
        child.start()
        if number % 2:
            time.sleep(float(draw.uniform(0, lasting)))
        else:
            while len(os.listdir(folder)) <= before and child.is_alive():
                time.sleep(0.0005)
            time.sleep(float(draw.uniform(0, 0.004)))
        child.kill()
        child.join()
        seen["writing"] += len(os.listdir(folder)) > before
        try:
            load_bundle(path)
            seen["lost"] += path.read_bytes() not in versions
        except (OSError, ValueError):
            seen["lost"] += 1
    seen["left"] = len(os.listdir(folder)) - 1
    return seen


def _memory() -> float:
    """Return the most memory that this process has had, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
