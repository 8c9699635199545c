"""DryRobot: a robot that is asked where it is and never moved."""

from __future__ import annotations

from typing import Any

from shape_obs.robot import ActionSpec, Anchors, Array, Robot, robot_anchors, robot_name


class DryRobot:
    """Stands before a robot and lets no motion through; connecting, its state and ``stop`` are the robot's own.

    Args:
        robot: The robot.

    Attributes:
        sent: How many motions were swallowed.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self.sent = 0

    @property
    def name(self) -> str:
        """Of the robot, marked."""
        return f"{robot_name(self._robot)} (dry run)"

    @property
    def action_spec(self) -> ActionSpec:
        """The robot's."""
        return self._robot.action_spec

    @property
    def anchors(self) -> Anchors:
        """The robot's."""
        return robot_anchors(self._robot)

    @property
    def shape_obs_defaults(self) -> Any:
        """The robot's."""
        return getattr(self._robot, "shape_obs_defaults", {})

    def source(self) -> Any:
        """The camera that the robot brings.

        Raises:
            ValueError: It brings none.
        """
        own = getattr(self._robot, "source", None)
        if own is None:
            raise ValueError(f"source 'robot': {robot_name(self._robot)} brings no camera; name one, such as 'd455'.")
        return own()

    def connect(self) -> None:
        """Connect the robot."""
        self._robot.connect()

    def reset(self) -> None:
        """Stay where it is."""

    def send(self, action: Array, until: float) -> None:
        """Count the motion and drop it."""
        self.sent += 1

    def state(self) -> Array:
        """The robot's."""
        return self._robot.state()

    def stop(self) -> None:
        """Stop the robot: somebody else may have moved it."""
        self._robot.stop()

    def park(self) -> None:
        """Stay where it is."""

    def disconnect(self) -> None:
        """Disconnect the robot."""
        self._robot.disconnect()
