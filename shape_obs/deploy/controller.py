"""Define controllers, which turn observations into actions, and three ready-made ones."""

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
    """An object with ``act``.

    Optional members: ``action_spec``, the meaning of its actions, which is compared with the robot's; ``reset()``,
    called before an episode; ``attach(env)``, called with the wrapped environment; ``bind(spec)``, called with the
    robot's ``ActionSpec``; and ``withheld()``, called if its last action was not sent because the image had become too
    old.
    """

    def act(self, observation: Any) -> npt.ArrayLike:
        """Return the action, of shape ``(A,)`` in -1 ... 1, for an observation of the wrapped environment."""
        ...


class Still:
    """Stand still, for example to check the camera and the rate."""

    def bind(self, spec: ActionSpec) -> None:
        """Store the number of coordinates."""
        self._size = len(spec)

    def act(self, observation: Any) -> npt.NDArray[np.float32]:
        """Return zeros."""
        return np.zeros(self._size, np.float32)


class Sway:
    """Move every coordinate back and forth with its own period, and return to the start.

    Args:
        share: Amplitude as a fraction of the largest action, 0 to 1.
        period: Period of the slowest coordinate in steps.

    Raises:
        ValueError: An argument is out of its range.
    """

    def __init__(self, share: float = 0.3, period: int = 120) -> None:
        if not 0 <= share <= 1 or period < 2:
            raise ValueError(f"Sway: expected share 0 ... 1 and a period of 2 steps or more, got {share}, {period}.")
        self._share, self._period, self._step = share, period, 0

    def bind(self, spec: ActionSpec) -> None:
        """Store the number of coordinates."""
        # Neighbouring coordinates have different periods, and all complete whole periods at the same time.
        self._turns = 1 + np.arange(len(spec)) % 3
        self._signs = np.where(np.arange(len(spec)) % 2, -1.0, 1.0)

    def reset(self) -> None:
        """Restart."""
        self._step = 0

    def act(self, observation: Any) -> npt.NDArray[np.float32]:
        """Return the next action."""
        # Cosines, since their sum, the position of the robot, is a sine around the start.
        phase = 2 * np.pi * self._turns * self._step / self._period
        self._step += 1
        return (self._share * self._signs * np.cos(phase)).astype(np.float32)


class Script:
    """Replay actions from an array or a file, then stand still.

    Args:
        actions: Actions of shape ``(T, A)`` in -1 ... 1, or a file of them: .npy, or .csv with a row for each step.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file or array holds something else.
    """

    def __init__(self, actions: npt.ArrayLike | str | Path) -> None:
        self._actions = _read(actions) if isinstance(actions, (str, Path)) else np.asarray(actions, np.float32)
        if self._actions.ndim != 2 or not np.isfinite(self._actions).all():
            raise ValueError(f"Script: expected finite actions (T, A), got an array of shape {self._actions.shape}.")
        self._step = 0

    def bind(self, spec: ActionSpec) -> None:
        """Check the number of coordinates.

        Raises:
            ValueError: The actions have another number of coordinates.
        """
        if self._actions.shape[1] != len(spec):
            raise ValueError(f"Script: its rows have {self._actions.shape[1]} numbers, the robot takes {len(spec)}.")

    def reset(self) -> None:
        """Restart."""
        self._step = 0

    def act(self, observation: Any) -> npt.NDArray[np.float32]:
        """Return the next row, or zeros after the last one."""
        step, self._step = self._step, self._step + 1
        return self._actions[step] if step < len(self._actions) else np.zeros(self._actions.shape[1], np.float32)


def check_controller(controller: Any, spec: ActionSpec, env: Any) -> None:
    """Check that an object is a controller for the robot's coordinates; then attach, bind and reset it.

    Raises:
        TypeError: The object has no ``act``.
        ValueError: Its ``action_spec`` differs from the robot's.
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
    """Return an action as floats of shape ``(A,)``.

    Raises:
        ValueError: The action has another shape, or is not finite.
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
        raise ValueError(
            f"{path}: expected actions as .npy (T, A), or .csv with a row for each step: {error}"
        ) from error
    return np.asarray(loaded, np.float32)
