"""What trainings need beside an env: a curriculum, and other observations to compare a shape's with.

``GoalDifference`` and ``ImageAndGoal`` need the extra ``sb3``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from shape_obs.training.curriculum import Curriculum
from shape_obs.training.pixels import Pixels
from shape_obs.training.point_reward import PointReward
from shape_obs.training.shuffled import Shuffled
from shape_obs.training.true_state import TrueState

if TYPE_CHECKING:
    from shape_obs.training.extractors import GoalDifference as GoalDifference
    from shape_obs.training.extractors import ImageAndGoal as ImageAndGoal

__all__ = ["Curriculum", "GoalDifference", "ImageAndGoal", "Pixels", "PointReward", "Shuffled", "TrueState"]


def __getattr__(name: str) -> Any:
    if name in ("GoalDifference", "ImageAndGoal"):
        from shape_obs.training import extractors

        return getattr(extractors, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
