"""Define the contract of a robot: what its actions mean, how it moves, and how it stops."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from shape_obs.spec import Spec, SpecError

Array = npt.NDArray[np.float64]
Mode = Literal["displacement", "velocity", "position"]
ActionFrame = Literal["base", "gripper", "joint"]
UNITS: Final = ("m", "rad", "1")


class RobotError(OSError):
    """A robot does not do what it was told; the message says what it was, and what to try."""


@dataclass(frozen=True)
class ActionSpec(Spec):
    """What a robot's action means: A coordinates, in physical units.

    A policy or controller acts in -1 ... 1 for each coordinate; ``scale`` says how much 1 is.

    Args:
        names: Of the coordinates, such as ``("gripper0/x", "gripper0/y", "gripper0/yaw")``.
        units: Of each coordinate: ``"m"``, ``"rad"`` or ``"1"`` (a share, as of a gripper's opening).
        scale: What 1 means, in these units; per step for displacements, per second for velocities.
        low: The least that a coordinate of the state may become: the workspace, in these units.
        high: The most.
        mode: ``"displacement"`` is added to the state, ``"velocity"`` too, by the second, ``"position"`` replaces it.
        frame: What the coordinates are told in: the robot's ``"base"``, its ``"gripper"``, or its ``"joint"`` angles.

    Raises:
        SpecError: Lengths that differ, or numbers that are none.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    scale: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    mode: Mode = "displacement"
    frame: ActionFrame = "base"

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("units", "scale", "low", "high"):
            if len(getattr(self, name)) != len(self.names):
                raise SpecError(
                    f"ActionSpec.{name}: expected {len(self.names)} values, one for each of the coordinates "
                    f"{list(self.names)}, got {len(getattr(self, name))}."
                )
        if not self.names or len(set(self.names)) != len(self.names):
            raise SpecError(f"ActionSpec.names: expected different names of the coordinates, got {list(self.names)}.")
        wrong = [unit for unit in self.units if unit not in UNITS]
        if wrong:
            raise SpecError(f"ActionSpec.units: expected {', '.join(map(repr, UNITS))}, got {wrong[0]!r}.")
        if not all(0 < scale < np.inf for scale in self.scale):
            raise SpecError(f"ActionSpec.scale: expected positive numbers, got {list(self.scale)}.")
        if not all(-np.inf < low < high < np.inf for low, high in zip(self.low, self.high, strict=True)):
            raise SpecError(
                f"ActionSpec: expected finite low < high, got low {list(self.low)} and high {list(self.high)}."
            )

    def __len__(self) -> int:
        return len(self.names)

    def physical(self, action: npt.ArrayLike) -> Array:
        """An action of -1 ... 1 in physical units: (A,) -> (A,)."""
        return np.asarray(action, np.float64) * self.scale

    def following(self, state: npt.ArrayLike, motion: npt.ArrayLike, dt: float) -> Array:
        """The state (A,) that ``motion`` (A,), in physical units, leads to from ``state`` within ``dt`` seconds."""
        state, motion = np.asarray(state, np.float64), np.asarray(motion, np.float64)
        return motion if self.mode == "position" else state + motion * (dt if self.mode == "velocity" else 1.0)

    def leading(self, state: npt.ArrayLike, target: npt.ArrayLike, dt: float) -> Array:
        """The motion (A,), in physical units, that leads from ``state`` (A,) to ``target`` (A,) in ``dt`` seconds."""
        state, target = np.asarray(state, np.float64), np.asarray(target, np.float64)
        return target if self.mode == "position" else (target - state) / (dt if self.mode == "velocity" else 1.0)

    def check_same(self, other: ActionSpec, who: str) -> None:
        """Refuse actions that mean something else.

        Args:
            other: What ``who`` acts in.
            who: The policy's or controller's name, for the message.

        Raises:
            ValueError: Names, units, scale, mode or frame differ; the message says which. Workspaces may differ.
        """
        wanted, given = self.to_dict(), other.to_dict()
        different = [key for key in ("names", "units", "scale", "mode", "frame") if wanted[key] != given[key]]
        if different:
            told = "; ".join(f"{key}: {given[key]} against {wanted[key]}" for key in different)
            raise ValueError(f"{who} acts in other coordinates than the robot ({told}): convert its actions.")


@runtime_checkable
class Robot(Protocol):
    """Move the object. States and actions have the coordinates of ``action_spec``, in physical units.

    A robot keeps two promises on which the safety of a deployment rests:

    - Every motion ends by itself at its ``until``, by the clock of whatever controls the motors, even if the process
      that sent it has been killed. A driver for a controller on another machine sends the time that is left,
      ``until - time.monotonic()``, as the controller's own command timeout. Motions of ``reset`` and ``park`` end soon
      after the process is gone, too.
    - ``stop`` works at any time and from any thread, also while another thread is blocked in ``send``, ``reset`` or
      ``park``. It ends the motion that these have begun and cancels one that they have not begun yet.

    May also have ``anchors``, a mapping of names to base-frame points (x, y, z) where it holds the object now, and
    ``name`` for logs.
    """

    @property
    def action_spec(self) -> ActionSpec:
        """What actions mean."""
        ...

    def connect(self) -> None:
        """Open the connection, without any motion; nothing happens when it is open already.

        Raises:
            RobotError: It cannot.
        """
        ...

    def reset(self) -> None:
        """Go to the start of an episode; returns when it is there.

        Raises:
            RobotError: It cannot, or it is not connected.
        """
        ...

    def send(self, action: Array, until: float) -> None:
        """Begin a motion and return at once. The next motion replaces it.

        Args:
            action: (A,) in physical units, inside the workspace.
            until: ``time.monotonic()`` in seconds at which the robot must stand still again, wherever it is then,
                unless another motion has replaced this one. A motion whose time is over is not begun.

        Raises:
            RobotError: The motion cannot be begun.
        """
        ...

    def state(self) -> Array:
        """Return the commanded position (A,), where the current motion ends, in the coordinates of ``action_spec``."""
        ...

    def stop(self) -> None:
        """Stand still now. May be called at any time, from any thread, and more than once.

        While it is not connected nothing happens.

        Raises:
            RobotError: The robot cannot be reached.
        """
        ...

    def park(self) -> None:
        """Go to a pose where the robot may be left alone, and return when it is there.

        Raises:
            RobotError: It cannot, or it was stopped on the way.
        """
        ...

    def disconnect(self) -> None:
        """Close the connection, without any motion; nothing happens when it is closed already."""
        ...


Anchors = Mapping[str, Sequence[float]]
_METHODS: Final = ("connect", "reset", "send", "state", "stop", "park", "disconnect")


def check_robot(robot: Any) -> None:
    """Check that an object keeps the ``Robot`` protocol, as far as that shows before it moves.

    Raises:
        TypeError: A method is missing, or ``send`` does not take an action and its end.
    """
    name = type(robot).__name__
    missing = [method for method in _METHODS if not callable(getattr(robot, method, None))]
    if missing or not hasattr(robot, "action_spec"):
        raise TypeError(
            f"robot: expected an object as shape_obs.robot.Robot describes it, {name} has no "
            f"{(*missing, 'action_spec')[0]!r}."
        )
    try:
        signature = inspect.signature(robot.send)
    except ValueError:
        return  # a compiled function does not show its parameters
    try:
        signature.bind([], 0.0)
    except TypeError:
        got = f"{name}.send({', '.join(signature.parameters)})"
        raise TypeError(
            f"robot: expected {name}.send(action, until), got {got}: the robot must end each motion by itself at the "
            "time `until`."
        ) from None


def robot_anchors(robot: Any) -> Anchors:
    """Where the robot holds the object: name -> (x, y, z) metres, base frame; empty for a robot that does not say."""
    return getattr(robot, "anchors", {})


def robot_name(robot: Any) -> str:
    """What to call the robot in logs."""
    return str(getattr(robot, "name", type(robot).__name__))
