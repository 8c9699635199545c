"""The folder that a recording is: names of files, and how cameras and frames stand in them.

``camera.json`` is written first, images next, and a line of ``frames.jsonl`` only after the images it names: whatever
moment a recording is cut at, the lines that are there are whole. The last line says that the recording was ended.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from shape_obs.camera import CameraModel, Intrinsics

FORMAT: Final = "shape_obs recording"
VERSION: Final = 1
CAMERA_FILE: Final = "camera.json"
FRAMES_FILE: Final = "frames.jsonl"
END: Final = "end"


def camera_to_dict(camera: CameraModel | None) -> dict[str, Any]:
    """JSON-able; every number comes back to the bit."""
    place = None if camera is None else camera.transform_camera_to_base
    return {
        "intrinsics": None if camera is None else camera.intrinsics.to_dict(),
        "transform_camera_to_base": None if place is None else place.tolist(),
    }


def camera_from_dict(content: Mapping[str, Any]) -> CameraModel | None:
    """What ``camera_to_dict`` wrote.

    Raises:
        KeyError: A part is missing.
        ValueError: A part is no camera.
    """
    intrinsics, place = content["intrinsics"], content["transform_camera_to_base"]
    if intrinsics is None:
        return None
    return CameraModel(Intrinsics.from_dict(intrinsics), None if place is None else np.array(place, np.float64))
