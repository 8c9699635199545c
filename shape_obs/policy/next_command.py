"""The command that runs a policy after its training."""

from __future__ import annotations

import os
import shlex

from shape_obs.policy.contract import PolicyError
from shape_obs.policy.policy import load_policy

_ROBOT = "shape_obs_envs.robots:SimulatedRobot"
_DEFAULT_ENV = "ShapeObs/Cable-v0"  # of the simulated robot
#: Arguments of an environment that change its actions or goals; others are about its camera and its training.
_SAME_TASK = ("grippers", "rope", "ropes", "step")


def deploy_command(path: str | os.PathLike[str]) -> str:
    """Return the ``shape-obs deploy`` command that tries a policy on a simulated robot, for a shell.

    Args:
        path: A policy, as ``save_policy`` writes it.

    Raises:
        PolicyError: The policy cannot run with a camera; the message gives the reason.
    """
    policy = load_policy(path)
    policy.check_deployable()
    trained = policy.spec.trained.get("env") or {}
    env = str(trained.get("id", "")).rpartition(":")[2]
    if not env.startswith("ShapeObs/"):
        raise PolicyError(f"{env} has no simulated robot here: run `shape-obs deploy {path} --robot module:Class`.")
    words = ["shape-obs", "deploy", str(path), "--source", "robot", "--robot", _ROBOT]
    task = {name: value for name, value in trained["kwargs"].items() if name in _SAME_TASK}
    settings = [f"{name}={value}" for name, value in ({"env": env} | task).items() if value != _DEFAULT_ENV]
    if settings:
        words += ["--robot-set", *settings]
    if policy.spec.needs_goal and not policy.spec.has_goal:
        words += ["--goal", "robot"]
    return shlex.join([*words, "--episodes", "20"])
