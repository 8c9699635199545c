"""Read hostile bundles, each in a separate process, and report what they did.

``python -m fuzzing.bundle_trials FOLDER KILLS SEED`` reads ``FOLDER/files/*``, those named
``*.trusted`` with ``trust=True``. The process has all libraries loaded and forks for each file, so that time and memory
are those of the file alone. It prints one line of JSON for each, and one for the kills of processes that save a bundle.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import json
import os
import re
import resource
import select
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import gymnasium as gym
import numpy as np

from fuzzing.bundle_canary import VARIABLE
from fuzzing.bundle_kills import kill_savers
from fuzzing.bundle_sample import TRUSTED
from shape_obs import CameraModel, Intrinsics, load_bundle
from shape_obs.deploy.policy_bundle import Bundle, BundleError
from shape_obs.deploy.policy_bundle.spaces import space_from_dict, zeros

_MIB: Final = 2**20
#: Seconds after which a process is ended, and bytes of addresses beyond those of its parent.
_LONGEST: Final = 20.0
_MOST: Final = 1024 * _MIB
_SIZE: Final = 84
#: What each call may raise, by its docstring.
_DECLARED: Final[dict[str, tuple[type[Exception], ...]]] = {
    "load": (BundleError,),
    "act": (),
    "make_env": (BundleError, ImportError),
    "wrap": (BundleError, ValueError),
}


class Foreign(gym.Env[Any, Any]):
    """An environment of another package, which takes code and sizes from its arguments."""

    observation_space = gym.spaces.Box(-1.0, 1.0, (3,), np.float32)
    action_space = gym.spaces.Box(-1.0, 1.0, (2,), np.float32)

    def __init__(self, plugin: Any = None, size: int = 1) -> None:
        if plugin is not None:
            importlib.import_module(re.split(r"[:.]", re.sub(r"^\W+", "", str(plugin)))[0])
        self.memory = np.ones(size, np.int64)


class Cell(gym.Env[Any, Any]):
    """Images of a camera above a table, as a robot's cell has them."""

    def __init__(self) -> None:
        self.observation_space = gym.spaces.Dict(
            {
                "rgb": gym.spaces.Box(0, 255, (_SIZE, _SIZE, 3), np.uint8),
                "depth": gym.spaces.Box(0, 65535, (_SIZE, _SIZE), np.uint16),
            }
        )
        self.action_space = gym.spaces.Box(-1.0, 1.0, (6,), np.float32)
        transform = np.diag([1.0, -1.0, -1.0, 1.0])
        transform[2, 3] = 0.56
        self.camera_model = CameraModel(Intrinsics(_SIZE, _SIZE, 68.0, 68.0, 41.5, 41.5), transform)
        self.anchors = {"gripper0": (0.0, 0.0, 0.0)}


def main(folder: Path, kills: int, seed: int) -> None:
    """Read all files of a folder, then kill processes that save one."""
    import torch

    import shape_obs_envs  # noqa: F401 - registers the environments

    torch.set_num_threads(1)
    gym.register("BundleForeign-v0", f"{Foreign.__module__}:{Foreign.__name__}")
    gym.logger.min_level = gym.logger.ERROR
    warnings.simplefilter("ignore")
    attempt(folder / "sample.policy", folder, trust=False)  # what is loaded on first use
    importlib.import_module("torch._dynamo")  # PyTorch's own, for policies with a CNN or PPO
    gc.freeze()  # collecting in a fork would copy all of the parent's memory
    for path in sorted((folder / "files").iterdir()):
        print(json.dumps(in_fork(lambda path=path: attempt(path, folder, path.suffix == TRUSTED))), flush=True)
    if kills:
        with tempfile.TemporaryDirectory(dir=folder) as saved:
            print(json.dumps(kill_savers(Path(saved), kills, seed)), flush=True)


def attempt(path: Path, folder: Path, trust: bool) -> dict[str, Any]:
    """Load a file and, where that works, act, rebuild its environment and wrap another one.

    Returns:
        ``undeclared`` (errors that no docstring names), ``code`` (whether the canary's code ran), ``left`` (files in
        the temporary folder), ``seconds``, ``mb`` and ``read`` (whether the file was accepted).
    """
    canary = Path(os.environ[VARIABLE])
    canary.unlink(missing_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as temporary:
        tempfile.tempdir = temporary
        before, start = _memory(), time.perf_counter()
        undeclared: list[str] = []
        bundle: Bundle | None = _tried("load", lambda: load_bundle(path, trust=trust), undeclared)
        read = bundle is not None
        if bundle is not None:
            _use(bundle, undeclared)
        seconds, grown = time.perf_counter() - start, _memory() - before
        bundle = None
        gc.collect()  # its temporary folder goes with it
        left = len(os.listdir(temporary))
        tempfile.tempdir = None
    ran = canary.exists()
    canary.unlink(missing_ok=True)
    return {"undeclared": undeclared, "code": ran, "left": left, "seconds": seconds, "mb": grown, "read": read}


def in_fork(work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Run work in a forked process and return what it returned; a process that dies or hangs says so itself."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        limit = _addresses() + _MOST
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        with contextlib.suppress(BaseException), os.fdopen(writing, "w") as pipe:
            json.dump(work(), pipe)
        os._exit(0)
    os.close(writing)
    start, text = time.monotonic(), b""
    while select.select([reading], [], [], max(0.0, start + _LONGEST - time.monotonic()))[0]:
        piece = os.read(reading, 65536)
        if not piece:
            break
        text += piece
    os.close(reading)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    if text:
        return json.loads(text)
    seconds = time.monotonic() - start
    return {"undeclared": ["died or hung"], "code": False, "left": 0, "seconds": seconds, "mb": 0.0, "read": False}


def _tried(name: str, call: Callable[[], Any], undeclared: list[str]) -> Any:
    try:
        return call()
    except _DECLARED[name]:
        return None
    except BaseException as error:
        undeclared.append(f"{name}: {type(error).__name__}: {error}"[:300])
        if isinstance(error, KeyboardInterrupt):
            raise
        return None


def _use(bundle: Bundle, undeclared: list[str]) -> None:
    _tried("act", lambda: _act(bundle), undeclared)
    env = _tried("make_env", bundle.make_env, undeclared)
    if env is not None:
        env.close()
    _tried("wrap", lambda: bundle.wrap(Cell()), undeclared)


def _act(bundle: Bundle) -> None:
    bundle.act(zeros(space_from_dict(bundle.record.observation_space, "observation")))


def _memory() -> float:
    """Return the most memory that this process has had, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _addresses() -> int:
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
