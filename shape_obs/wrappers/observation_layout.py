"""The layout of a wrapped observation: its space, the kept keys and the goals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from shape_obs.spec import did_you_mean
from shape_obs.wrappers.env_protocol import GOALS

Vector = npt.NDArray[np.float32]


class Bounded(Protocol):
    """Lowest and highest values, ``(D,)`` each: a ``FeatureVector``, a ``GoalVector`` or a ``Box``."""

    @property
    def low(self) -> npt.NDArray[Any]:
        """Lowest values."""
        ...

    @property
    def high(self) -> npt.NDArray[Any]:
        """Highest values."""
        ...


class ObservationLayout:
    """Combine features, kept keys and goals into one observation.

    Args:
        source: The env's observation space.
        keep: Keys of the env's observation to pass on. In a goal-conditioned env, kept vectors become part of
            ``observation``, because policies read only that and the goals.
        vector: Bounds of the features.
        goal: Bounds of the goals, if there are any.

    Attributes:
        space: The wrapped observation space.
        flat: Whether the observation is the feature vector alone.

    Raises:
        ValueError: A key cannot be kept.
    """

    def __init__(self, source: spaces.Space[Any], keep: Sequence[str], vector: Bounded, goal: Bounded | None) -> None:
        kept = _kept_spaces(source, keep, privileged=GOALS if goal is not None else ())
        self._kept = spaces.Dict(dict(kept))
        self._joined = [key for key, space in kept.items() if goal is not None and _is_vector(space)]
        self._separate = [key for key in kept if key not in self._joined]
        low, high = [np.asarray(vector.low, np.float32)], [np.asarray(vector.high, np.float32)]
        for key in self._joined:
            low.append(np.asarray(kept[key].low, dtype=np.float32))
            high.append(np.asarray(kept[key].high, dtype=np.float32))
        box = spaces.Box(np.concatenate(low), np.concatenate(high), dtype=np.float32)
        separate = {key: kept[key] for key in self._separate}
        self._name: str | None = "observation" if goal is not None else "shape" if keep else None
        self.flat = self._name is None
        if self._name in separate:
            raise ValueError(
                f"keep: {self._name!r} is the key that this wrapper uses for the shape; rename the env's key."
            )
        if goal is not None:
            bounds = spaces.Box(goal.low, goal.high, dtype=np.float32)
            self.space: spaces.Space[Any] = spaces.Dict(
                {"observation": box, **dict.fromkeys(GOALS, bounds), **separate}
            )
        elif self._name is not None:
            self.space = spaces.Dict({self._name: box, **separate})
        else:
            self.space = box

    def compose(self, values: Vector, source: Any, goals: Sequence[Vector] = ()) -> Any:
        """Return the observation of features, kept values of ``source``, and (achieved, desired) goals.

        Raises:
            KeyError: ``source`` lacks a kept key.
            ValueError: A kept array has another shape than its space, or is NaN.
        """
        if self._name is None:
            return values
        kept = _checked(source, self._kept, "observation")
        joined = np.concatenate([values, *(np.asarray(kept[key], np.float32) for key in self._joined)])
        separate = {key: deepcopy(kept[key]) for key in self._separate}
        return {self._name: joined, **dict(zip(GOALS, goals, strict=False)), **separate}


def _checked(value: Any, space: spaces.Space[Any], where: str) -> Any:
    """Return a kept value; bounds are left to the env, which may exceed them by rounding."""
    if isinstance(space, spaces.Dict):
        for key, part in space.spaces.items():
            if key not in value:
                raise KeyError(f"{where} has no {key!r}, but its space does; keys: {sorted(value)}.")
            _checked(value[key], part, f"{where}[{key!r}]")
    elif isinstance(space, spaces.Box):
        floats = space.dtype is not None and space.dtype.kind == "f"
        if np.shape(value) != space.shape or (floats and np.isnan(value).any()):
            raise ValueError(
                f"keep: the env's observation_space promises {where} as finite numbers of shape {space.shape}, the env "
                f"gave shape {np.shape(value)}{', NaN among them' if np.shape(value) == space.shape else ''}."
            )
    elif not space.contains(value):
        raise ValueError(f"keep: the env's observation_space promises {where} in {space}, the env gave {value!r:.100}.")
    return value


def _is_vector(space: spaces.Space[Any]) -> bool:
    return isinstance(space, spaces.Box) and len(space.shape) == 1


def _kept_spaces(source: spaces.Space[Any], keep: Sequence[str], privileged: Sequence[str]) -> Mapping[str, Any]:
    if not keep:
        return {}
    if not isinstance(source, spaces.Dict):
        raise ValueError(f"keep={list(keep)} needs a Dict observation, got {source}.")
    for key in keep:
        if key in privileged:
            raise ValueError(
                f"keep: {key!r} comes from the simulator's state; this wrapper computes it from the camera."
            )
        if key not in source.spaces:
            raise ValueError(f"keep: no key {key!r} in the observation{did_you_mean(key, source.spaces)}")
    return {key: source[key] for key in keep}


def main_part(space: spaces.Space[Any], main: str) -> tuple[str | None, spaces.Box, list[str]]:
    """Return the key of the vector of ``ShapeObservation`` (None without keys), its box, and the other keys."""
    keys = list(space.spaces) if isinstance(space, spaces.Dict) else None
    box = space[main] if isinstance(space, spaces.Dict) and main in space.spaces else space
    if not isinstance(box, spaces.Box):
        raise ValueError(f"ShapeGoal: expected a Box, or a Dict with a Box as {main!r}, got {space}.")
    if keys is None:
        return None, box, []
    return main, box, [key for key in keys if key not in (main, *GOALS)]
