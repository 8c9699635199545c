"""Writing pictures: clear errors, and nothing half-written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from shape_obs.utils.arrays import read_depth as read_depth
from shape_obs.utils.arrays import read_image as read_image
from shape_obs.utils.files import make_folder as make_folder
from shape_obs.utils.files import write_whole


def write_image(path: Path, rgb: npt.NDArray[np.uint8]) -> None:
    """Write a (H,W,3) RGB picture, whole or not at all."""
    write_whole(path, lambda temporary: Image.fromarray(rgb).save(temporary))


def write_gif(path: Path, frames: Sequence[npt.NDArray[np.uint8]], seconds_per_frame: float) -> None:
    """Write an animated GIF of (H,W,3) RGB frames, whole or not at all."""
    pictures = [Image.fromarray(frame).quantize(128, dither=Image.Dither.NONE) for frame in frames]
    duration = max(round(1000 * seconds_per_frame), 20)
    write_whole(
        path,
        lambda temporary: pictures[0].save(
            temporary, save_all=True, append_images=pictures[1:], duration=duration, loop=0, optimize=True
        ),
    )
