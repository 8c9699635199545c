"""Controllers: what turns an observation into an action; here those that follow a script."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from shape_obs.robot import ActionSpec
from shape_obs.utils.arrays import decode_npy


@runtime_checkable
class Controller(Protocol):
    """Anything with ``act``.

    It may also have ``action_spec``, what its actions mean, which is then held against the robot's; ``reset()``, called
    before an episode; ``attach(env)``, called with the wrapped environment; ``bind(spec)``, called with the robot's
    ``ActionSpec`` by which it can size its actions; and ``withheld()``, called where its last action was not sent,
    because the image had grown too old meanwhile.
    """

    def act(self, observation: Any) -> npt.ArrayLike:
        """The action (A,) in -1 ... 1 for an observation of the wrapped environment."""
        ...


class Still:
    """Does nothing: to look at what the camera sees, and at how fast."""

    def bind(self, spec: ActionSpec) -> None:
        """Take the number of coordinates."""
        self._size = len(spec)

    def act(self, observation: Any) -> npt.NDArray[np.float32]:
        """Zeros."""
        return np.zeros(self._size, np.float32)


class Sway:
    """Moves every coordinate to and fro, each with its own period: a displacement that comes back to where it began.

    Args:
        share: Of the largest action, 0 to 1.
        period: Of the slowest coordinate, in steps.
    """

    def __init__(self, share: float = 0.3, period: int = 120) -> None:
        if not 0 <= share <= 1 or period < 2:
            raise ValueError(f"Sway: expected share 0 ... 1 and a period of 2 steps or more, got {share}, {period}.")
        self._share, self._period, self._step = share, period, 0

    def bind(self, spec: ActionSpec) -> None:
        """Take the number of coordinates."""
        # No two in step, and whole turns for all in the same time.
        self._turns = 1 + np.arange(len(spec)) % 3
        self._signs = np.where(np.arange(len(spec)) % 2, -1.0, 1.0)

    def reset(self) -> None:
        """Begin anew."""
        self._step = 0

    def act(self, observation: Any) -> npt.NDArray[np.float32]:
        """The next action."""
        # Cosines: their sum, where the robot is, is a sine about the start.
        phase = 2 * np.pi * self._turns * self._step / self._period
        self._step += 1
        return (self._share * self._signs * np.cos(phase)).astype(np.float32)


class Script:
    """Plays actions from a file, then stands still.

    Args:
        actions: (T, A) in -1 ... 1, or a file of them: .npy, or .csv with a row for each step.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It holds something else.
    """

    def __init__(self, actions: npt.ArrayLike | str | Path) -> None:
        self._actions = _read(actions) if isinstance(actions, (str, Path)) else np.asarray(actions, np.float32)
        if self._actions.ndim != 2 or not np.isfinite(self._actions).all():
            raise ValueError(f"Script: expected finite actions (T, A), got an array of shape {self._actions.shape}.")
        self._step = 0

    def bind(self, spec: ActionSpec) -> None:
        """Check the number of coordinates.

        Raises:
            ValueError: It is another.
        """
        if self._actions.shape[1] != len(spec):
            raise ValueError(f"Script: its rows have {self._actions.shape[1]} numbers, the robot takes {len(spec)}.")

    def reset(self) -> None:
        """Begin anew."""
        self._step = 0

    def act(self, observation: Any) -> npt.NDArray[np.float32]:
        """The next row; zeros after the last."""
        step, self._step = self._step, self._step + 1
        return self._actions[step] if step < len(self._actions) else np.zeros(self._actions.shape[1], np.float32)


def check_controller(controller: Any, spec: ActionSpec, env: Any) -> None:
    """Refuse what is no controller, or one that acts in other coordinates; then attach, bind and reset it.

    Raises:
        TypeError: It has no ``act``.
        ValueError: Its ``action_spec`` is not the robot's.
    """
    name = type(controller).__name__
    if not callable(getattr(controller, "act", None)):
        raise TypeError(f"controller: expected an object with act(observation), got {name}.")
    own = getattr(controller, "action_spec", None)
    if own is not None:
        spec.check_same(own, f"controller {name}")
    for call, arguments in (("attach", (env,)), ("bind", (spec,)), ("reset", ())):
        method = getattr(controller, call, None)
        if callable(method):
            method(*arguments)


def checked_action(action: npt.ArrayLike, spec: ActionSpec, controller: Any) -> npt.NDArray[np.float64]:
    """An action as (A,) floats.

    Raises:
        ValueError: A wrong shape, or numbers that are not finite.
    """
    array = np.asarray(action, np.float64)
    if array.shape != (len(spec),) or not np.isfinite(array).all():
        wanted: Sequence[str] = spec.names
        raise ValueError(
            f"controller {type(controller).__name__}: expected {len(wanted)} finite numbers for {list(wanted)}, "
            f"got {action!r}. The robot was stopped."
        )
    return array


def _read(path: str | Path) -> npt.NDArray[np.float32]:
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file of actions")
    try:
        npy = path.suffix == ".npy"
        loaded = decode_npy(path.read_bytes(), path.name) if npy else np.loadtxt(path, delimiter=",", ndmin=2)
    except ValueError as error:
        raise ValueError(f"{path}: expected actions as .npy (T, A), or .csv with a row a step: {error}") from error
    return np.asarray(loaded, np.float32)
