"""Describe the steps of an environment or a robot that lie between the frames of a recording."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from shape_obs.robot import ActionSpec
from shape_obs.spec import Spec, SpecError


@dataclass(frozen=True)
class Transition(Spec):
    """The step that led to a frame: an action, and what ``env.step`` returned with the frame.

    Args:
        step: Number of steps since the episode began; 0 for its first frame, to which no step led.
        action: ``(A,)`` action, named by ``RobotInfo.action``; None if the robot was made to stand still instead, and
            for the first frame.
        reward: Reward of the step; None for the first frame.
        terminated: Whether the step ended the episode, such as by reaching the goal.
        truncated: Whether the episode was cut off after the step, such as by a time limit.

    Raises:
        SpecError: A value of the wrong type or out of range.
    """

    step: int
    action: tuple[float, ...] | None = None
    reward: float | None = None
    terminated: bool = False
    truncated: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.step < 2**63:
            raise SpecError(f"transition.step: expected 0 or more, got {self.step}.")


@dataclass(frozen=True)
class RobotInfo(Spec):
    """The meaning of the actions and states of a recording.

    Args:
        name: Name of the robot, or id of the environment.
        action: Names of the values of an action; empty if there are no actions.
        state: Names of the values of a state; empty if the state is unknown.
        action_spec: Units, scale and frame of the actions, if known.
    """

    name: str
    action: tuple[str, ...] = ()
    state: tuple[str, ...] = ()
    action_spec: ActionSpec | None = None


def plain(values: Iterable[Any]) -> tuple[float, ...]:
    """Return numbers as Python floats, which a line of ``frames.jsonl`` restores exactly."""
    return tuple(float(value) for value in values)
