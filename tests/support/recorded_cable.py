"""The simulated cable that tests of recordings record and replay."""

from __future__ import annotations

from typing import Any

from shape_obs import ShapeDetector
from shape_obs.config.config_file import detector_arguments

CABLE = "shape_obs_envs:ShapeObs/Cable-v0"
OPTIONS: dict[str, Any] = {"actions": "random", "seed": 4, "renderer": "rays", "camera": [128, 96]}
CONFIG: dict[str, Any] = {
    "shapes": [
        {"kind": "centerline", "name": "rope", "n": 12, "anchor": "gripper0", "ends": "tips", "spacing": "m"},
        {"kind": "contour", "n": 16},
    ],
    "segmentation": {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]},
    "features": ["points3d"],
}
FRAMES = 56  # beyond the end of the first episode


def detector():
    return ShapeDetector(**detector_arguments(CONFIG))
