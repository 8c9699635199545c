"""The checkers of Gymnasium and of Stable-Baselines3, for all tests of environments and wrappers."""

from __future__ import annotations

import warnings
from typing import Any

import gymnasium as gym
from gymnasium.utils.env_checker import check_env

#: Gymnasium's remarks that are no faults.
_HARMLESS = (
    ".*is different from the unwrapped version",
    "features: .* lie outside their bounds",
    ".*Casting .* spaces",
)


def check_both(env: gym.Env[Any, Any]) -> None:
    """Check an environment with both checkers; a warning fails. Stable-Baselines3 may not be installed."""
    # Imported first: what the libraries warn of on import is no fault of the environment.
    try:
        from stable_baselines3.common.env_checker import check_env as check_sb3
    except ModuleNotFoundError:
        check_sb3 = None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for message in _HARMLESS:
            warnings.filterwarnings("ignore", message=message)
        check_env(env, skip_render_check=True)
        if check_sb3 is not None:
            check_sb3(env, warn=False)
