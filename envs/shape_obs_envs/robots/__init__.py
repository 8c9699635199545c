"""Robots: one without hardware, and one that is simulated in real time in front of a software camera.

The classes are imported on first use, so MuJoCo is loaded only for simulation.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from shape_obs_envs.robots.null import NullRobot as NullRobot
    from shape_obs_envs.robots.simulated import SimulatedRobot as SimulatedRobot

_HOME = {"NullRobot": "null", "SimulatedRobot": "simulated"}

__all__ = sorted(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it has: {', '.join(__all__)}.")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
