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
    """A robot cannot carry out a command; the message contains the command and what to try."""


@dataclass(frozen=True)
class ActionSpec(Spec):
    """The meaning of a robot's action: A coordinates in physical units.

    Policies and controllers use -1 ... 1 for each coordinate; ``scale`` is the physical value of 1.

    Args:
        names: Names of the coordinates, such as ``("gripper0/x", "gripper0/y", "gripper0/yaw")``.
        units: Unit of each coordinate: ``"m"``, ``"rad"`` or ``"1"`` (a ratio, such as the opening of a gripper).
        scale: The value of 1 in these units; per step for displacements, per second for velocities.
        low: Lower limits of the state, that is of the workspace, in these units.
        high: Upper limits of the state.
        mode: ``"displacement"`` is added to the state, ``"velocity"`` is added per second, ``"position"`` replaces it.
        frame: The frame of the coordinates: the robot's ``"base"``, its ``"gripper"``, or its ``"joint"`` angles.

    Raises:
        SpecError: The lengths differ, or a number is out of range.
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
                    f"ActionSpec.{name}: expected {len(self.names)} values, one per coordinate of "
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
        """Convert an action ``(A,)`` from -1 ... 1 to physical units."""
        return np.asarray(action, np.float64) * self.scale

    def following(self, state: npt.ArrayLike, motion: npt.ArrayLike, dt: float) -> Array:
        """Return the state ``(A,)`` after a motion ``(A,)`` in physical units from ``state`` within ``dt`` seconds."""
        state, motion = np.asarray(state, np.float64), np.asarray(motion, np.float64)
        return motion if self.mode == "position" else state + motion * (dt if self.mode == "velocity" else 1.0)

    def leading(self, state: npt.ArrayLike, target: npt.ArrayLike, dt: float) -> Array:
        """Return the motion (A,) in physical units from ``state`` (A,) to ``target`` (A,) in ``dt`` seconds."""
        state, target = np.asarray(state, np.float64), np.asarray(target, np.float64)
        return target if self.mode == "position" else (target - state) / (dt if self.mode == "velocity" else 1.0)

    def check_same(self, other: ActionSpec, who: str) -> None:
        """Reject actions with another meaning.

        Args:
            other: The meaning of the actions of ``who``.
            who: The name of the policy or controller, for the error message.

        Raises:
            ValueError: Names, units, scale, mode or frame differ; the message lists them. Workspaces may differ.
        """
        wanted, given = self.to_dict(), other.to_dict()
        different = [key for key in ("names", "units", "scale", "mode", "frame") if wanted[key] != given[key]]
        if different:
            differences = "; ".join(f"{key}: {given[key]} against {wanted[key]}" for key in different)
            raise ValueError(f"{who} acts in other coordinates than the robot ({differences}): convert its actions.")


@runtime_checkable
class Robot(Protocol):
    """A robot that moves the object. States and actions have the coordinates of ``action_spec``, in physical units.

    The safety of a deployment depends on two guarantees of a robot:

    - Every motion ends by itself at its ``until``, by the clock of the motor controller, even if the process that sent
      it has been killed. A driver for a controller on another machine sends the remaining time,
      ``until - time.monotonic()``, as the controller's own command timeout. Motions of ``reset`` and ``park`` also end
      soon after the process is gone.
    - ``stop`` works at any time and from any thread, even while another thread is blocked in ``send``, ``reset`` or
      ``park``. It ends the motion that these have started and cancels one that they have not started yet.

    A robot may also have ``anchors``, a mapping of names to base-frame points (x, y, z) where it holds the object now;
    ``measured``, a mapping of names to numbers that recordings keep next to ``state()``, such as joint angles, the pose
    of the tool or forces; and ``name`` for logs.
    """

    @property
    def action_spec(self) -> ActionSpec:
        """The meaning of actions."""
        ...

    def connect(self) -> None:
        """Open the connection, without any motion, unless it is already open.

        Raises:
            RobotError: The connection cannot be opened.
        """
        ...

    def reset(self) -> None:
        """Go to the start of an episode, and return when the robot is there.

        Raises:
            RobotError: The robot cannot go there, or is not connected.
        """
        ...

    def send(self, action: Array, until: float) -> None:
        """Start a motion and return at once. The next motion replaces it.

        Args:
            action: ``(A,)`` in physical units, inside the workspace.
            until: ``time.monotonic()`` in seconds at which the robot must stand still again, wherever it is, unless
                another motion has replaced this one. A motion whose time is over is not started.

        Raises:
            RobotError: The motion cannot be started.
        """
        ...

    def state(self) -> Array:
        """Return the commanded position (A,), where the current motion ends, in the coordinates of ``action_spec``."""
        ...

    def stop(self) -> None:
        """Stop now. May be called at any time, from any thread, and more than once.

        Does nothing while the robot is not connected.

        Raises:
            RobotError: The robot cannot be reached.
        """
        ...

    def park(self) -> None:
        """Go to a safe pose, and return when the robot is there.

        Raises:
            RobotError: The robot cannot go there, or was stopped on the way.
        """
        ...

    def disconnect(self) -> None:
        """Close the connection, without any motion, unless it is already closed."""
        ...


Anchors = Mapping[str, Sequence[float]]
_METHODS: Final = ("connect", "reset", "send", "state", "stop", "park", "disconnect")


def check_robot(robot: Any) -> None:
    """Check that an object has the interface of ``Robot``, as far as this is possible without a motion.

    Raises:
        TypeError: A method is missing, or ``send`` does not accept an action and its end.
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
    """Return the points (x, y, z) in metres, base frame, where the robot holds the object, by name; possibly empty."""
    return getattr(robot, "anchors", {})


def measured(robot: Any) -> Mapping[str, float]:
    """Return the numbers that the robot measures now, by name, in a fixed order; empty if it publishes none."""
    return getattr(robot, "measured", {})


def robot_name(robot: Any) -> str:
    """Return the name of the robot for logs."""
    return str(getattr(robot, "name", type(robot).__name__))
