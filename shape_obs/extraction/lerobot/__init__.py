"""Write extracted episodes as a LeRobot dataset, version 3."""

from __future__ import annotations

from shape_obs.extraction.lerobot.dataset import check_lerobot_folder as check_lerobot_folder
from shape_obs.extraction.lerobot.dataset import write_lerobot as write_lerobot
from shape_obs.extraction.lerobot.writer import LeRobotSummary as LeRobotSummary
