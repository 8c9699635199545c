"""Read bundles, each in a separate process, and report what they did.

``python -m fuzzing.bundle_trials FOLDER`` reads ``FOLDER/files/*``, ``*.trusted`` with ``trust=True``, and prints a
line of JSON for each. It has loaded all libraries and forks for each file: time and memory are those of the file alone.
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
from fake_cell import make_env

from fuzzing.hostile_bundles import VARIABLE
from shape_obs import load_bundle
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


def main(folder: Path) -> None:
    """Read all files of a folder."""
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


def _memory() -> float:
    """Return the most memory that this process has had, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


if __name__ == "__main__":
    main(Path(sys.argv[1]))
