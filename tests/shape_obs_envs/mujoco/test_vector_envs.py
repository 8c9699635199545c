"""Vector environments: each sub-environment keeps its own track, and final observations are correct."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from rope_env import BLUE, RopeEnv

from shape_obs import ShapeObservation

HIDE = ([], [2], [1, 2, 3])  # a held shape is state: were it shared, the sub-envs would give each other's points
LENGTHS = (3, 5, 4)
STEPS = 9
FEATURES = ["points3d", "ok", "age"]


def make(i: int) -> gym.Env[Any, Any]:
    return ShapeObservation(RopeEnv(hide=HIDE[i], length=LENGTHS[i]), segmentation=BLUE, features=FEATURES)


def actions() -> np.ndarray:
    return np.random.default_rng(1).uniform(-1, 1, (STEPS, 3, 1)).astype(np.float32)


class Alone:
    """One env stepped by hand under an autoreset mode: (observation, final observation or None) of each step."""

    def __init__(self, i: int, mode: AutoresetMode) -> None:
        self.env, self.mode, self.over = make(i), mode, False

    def step(self, action: np.ndarray) -> tuple[np.ndarray, bool, np.ndarray | None]:
        if self.mode is AutoresetMode.NEXT_STEP and self.over:
            self.over = False
            return self.env.reset()[0], False, None
        observation, _, terminated, truncated, _ = self.env.step(action)
        self.over = terminated or truncated
        if self.over and self.mode is AutoresetMode.SAME_STEP:
            return self.env.reset()[0], True, observation
        return observation, self.over, None


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("kind", [SyncVectorEnv, AsyncVectorEnv])
def test_sub_envs_are_as_if_alone(kind, mode):
    envs = kind([partial(make, i) for i in range(3)], autoreset_mode=mode)
    try:
        alone = [Alone(i, mode) for i in range(3)]
        first, _ = envs.reset(seed=[10, 11, 12])
        for i, single in enumerate(alone):
            np.testing.assert_array_equal(first[i], single.env.reset(seed=10 + i)[0])
        endings = 0
        over = np.zeros(3, bool)
        for action in actions():
            if mode is AutoresetMode.DISABLED and over.any():
                observation, _ = envs.reset(options={"reset_mask": over})
                for i in np.flatnonzero(over):
                    np.testing.assert_array_equal(observation[i], alone[i].env.reset()[0])
            observation, _, _, truncated, info = envs.step(action)
            for i, single in enumerate(alone):
                expected, ended, final = single.step(action[i])
                np.testing.assert_array_equal(observation[i], expected)
                assert truncated[i] == ended
                endings += ended
                if final is not None:
                    assert info["_final_obs"][i]
                    np.testing.assert_array_equal(info["final_obs"][i], final)
                    assert not np.array_equal(final, expected)
            over = truncated.copy()
        assert endings >= 4
    finally:
        envs.close()


def test_info_scalars_become_arrays():
    envs = SyncVectorEnv([partial(make, i) for i in range(3)])
    envs.reset(seed=0)
    _, _, _, _, info = envs.step(actions()[0])
    assert info["shape/ok"].tolist() == [True] * 3
    assert info["shape/age"].tolist() == pytest.approx([0, 0, 0.1])
    assert info["shape/centerline/valid_fraction"].tolist() == [1, 1, 0]


FORK = """
import multiprocessing, sys
import numpy as np, cv2
from gymnasium.vector import AsyncVectorEnv
from functools import partial
sys.path.insert(0, sys.argv[1])
from rope_env import BLUE, RopeEnv
from shape_obs import ShapeDetector, ShapeObservation

def big():
    rng = np.random.default_rng(0)
    image = rng.integers(0, 255, (1200, 1600, 3), np.uint8)
    image[600:620, 100:1500] = (30, 60, 200)
    return ShapeDetector(segmentation={**BLUE, "open": 5, "close": 5, "min_area": 3000}).detect(image).ok

def make():
    return ShapeObservation(RopeEnv(), segmentation=BLUE)

def child(queue):
    queue.put((big(), cv2.getNumThreads()))

if __name__ == "__main__":
    cv2.setNumThreads(4)
    assert big()                      # every thread pool is warm
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    process = context.Process(target=child, args=(queue,))
    process.start()
    print(*queue.get(timeout=60), cv2.getNumThreads())
    process.join(60)
    env = make()
    env.reset(seed=0)
    envs = AsyncVectorEnv([make, make], context="fork")
    first, _ = envs.reset(seed=[0, 1])
    envs.step(np.zeros((2, 1), np.float32))
    envs.close()
    print(np.array_equal(first[0], env.reset(seed=0)[0]))
"""


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork here")
def test_a_fork_after_use_does_not_hang():
    """Threads do not survive a fork, and a library whose pool waits for them would hang."""
    free = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run(
        [sys.executable, "-c", FORK, str(Path(__file__).parents[2] / "support")],
        capture_output=True,
        text=True,
        timeout=120,
        env=free,
    )
    assert done.returncode == 0, done.stderr
    # The pool's threads exist only in the parent, and any lock that one of them held stays held in the child.
    assert done.stdout.split() == ["True", "1", "4", "True"]
