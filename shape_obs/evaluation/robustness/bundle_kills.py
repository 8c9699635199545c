"""Processes that are killed while they save a bundle over another one.

``python -m shape_obs.evaluation.robustness.bundle_kills FOLDER KILLS SEED`` forks the processes from one that has all
libraries loaded, and prints what it saw as JSON.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import gymnasium as gym
import numpy as np

from shape_obs import load_bundle, save_bundle
from shape_obs.evaluation.asked import at_least, at_most
from shape_obs.evaluation.robustness.bundle_trials import Foreign

#: Wide, so that writing the file takes a large part of saving it: about 10 MB.
_LAYERS: Final = [512, 512]
_SAVES: Final = 3
_MINUTES: Final = 10
#: Seconds that writing takes, and that it is waited for.
_WRITING: Final = 0.02
_LONGEST: Final = 30.0


def kill_claims(kills: int = 30, seed: int = 0) -> list[dict[str, Any]]:
    """Kill processes that save a bundle over another one again and again, each at a random instant.

    Every second instant is drawn from the whole of saving, the others from the writing of the file.

    Args:
        kills: How many.
        seed: Of the instants.

    Returns:
        Rows: what, asked, seen and whether it was reached.
    """
    with tempfile.TemporaryDirectory() as folder:
        module = "shape_obs.evaluation.robustness.bundle_kills"
        done = subprocess.run(
            [sys.executable, "-m", module, folder, str(kills), str(seed)],
            env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
            capture_output=True,
            text=True,
            timeout=60 * _MINUTES,
            check=False,
        )
    if done.returncode:
        raise RuntimeError(f"killing failed: {done.stderr[-2000:]}")
    seen = json.loads(done.stdout.splitlines()[-1])
    what = f"{kills} kills while a bundle is saved"
    return [
        at_most(f"{what}: lost or half-written bundles", 0, seen["broken"], ""),
        at_most(f"{what}: bundles that do not load", 0, seen["unread"], ""),
        at_least(f"{what}: kills during the writing of the file", 1, seen["writing"], ""),
        at_most(f"{what}: temporary files left beside it, a kill", 1, seen["left"] / kills, ""),
    ]


def main(folder: Path, kills: int, seed: int) -> dict[str, int]:
    """Save two versions, then kill processes that replace one by the other.

    Returns:
        ``broken``: kills after which the file was neither version. ``unread``: after which it did not load.
        ``writing``: that left a temporary file, since they hit the writing. ``left``: temporary files in the end.
    """
    import stable_baselines3 as sb3
    import torch

    torch.set_num_threads(1)
    gym.register("BundleForeign-v0", f"{Foreign.__module__}:{Foreign.__name__}")
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
        before = len(list(folder.iterdir()))
        if number % 2:
            _kill(save, lambda: None, float(rng.uniform(0, _SAVES * lasting)))
        else:
            _kill(save, lambda before=before: _until_written(folder, before), float(rng.uniform(0, _WRITING)))
        seen["writing"] += len(list(folder.iterdir())) > before
        seen["broken"] += not path.is_file() or path.read_bytes() not in versions
        try:
            load_bundle(path)
        except (OSError, ValueError):
            seen["unread"] += 1
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


if __name__ == "__main__":
    print(json.dumps(main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))))
