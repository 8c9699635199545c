"""The action nearest to none in any action space."""

from __future__ import annotations

from functools import singledispatch
from typing import Any

import numpy as np
from gymnasium import spaces


@singledispatch
def no_motion(space: spaces.Space[Any]) -> Any:
    """Zeros, where the space allows them; of discrete actions the first.

    Raises:
        ValueError: The space is of a kind for which nobody knows.
    """
    raise ValueError(f"which action of {space} is none? Give actions='random', or a function as actions=.")


@no_motion.register
def _(space: spaces.Box) -> Any:
    return np.clip(np.zeros(space.shape, space.dtype), space.low, space.high)


@no_motion.register
def _(space: spaces.Discrete) -> Any:
    return space.start


@no_motion.register
def _(space: spaces.MultiDiscrete) -> Any:
    return np.array(space.start)


@no_motion.register
def _(space: spaces.MultiBinary) -> Any:
    return np.zeros(space.shape, space.dtype)


@no_motion.register
def _(space: spaces.Dict) -> Any:
    return {key: no_motion(part) for key, part in space.spaces.items()}


@no_motion.register
def _(space: spaces.Tuple) -> Any:
    return tuple(no_motion(part) for part in space.spaces)
