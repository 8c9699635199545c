"""Wrappers and networks for training: a curriculum, a reward of points, and observations for comparison.

``GoalDifference``, ``ImageAndGoal`` and ``PixelPolicy`` need the extra ``sb3`` and are imported on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from shape_obs.training.comparisons import Pixels, Shuffled, TrueState
from shape_obs.training.curriculum import Curriculum
from shape_obs.training.point_reward import PointReward

if TYPE_CHECKING:
    from shape_obs.training.extractors import GoalDifference as GoalDifference
    from shape_obs.training.extractors import ImageAndGoal as ImageAndGoal
    from shape_obs.training.pixel_policy import PixelPolicy as PixelPolicy

__all__ = [
    "Curriculum", "GoalDifference", "ImageAndGoal", "PixelPolicy", "Pixels", "PointReward", "Shuffled", "TrueState",
]  # fmt: skip

_TORCH: Final = {"GoalDifference": "extractors", "ImageAndGoal": "extractors", "PixelPolicy": "pixel_policy"}


def __getattr__(name: str) -> Any:
    if name in _TORCH:
        return getattr(import_module(f"{__name__}.{_TORCH[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
