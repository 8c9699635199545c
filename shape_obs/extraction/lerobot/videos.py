"""Write the camera's images of an episode as a video that LeRobot decodes frame by frame."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.extraction.lerobot.statistics import Statistics, image_statistics
from shape_obs.extraction.task import Task
from shape_obs.recording.format import read_moments
from shape_obs.recording.video import H264Encoder, find_ffmpeg
from shape_obs.source import RGBDSource
from shape_obs.utils.errors import install_hint

#: Every second picture is a key frame and none refers to a later one, so that random access is fast.
_RANDOM_ACCESS: Final = ("-g", "2", "-bf", "0")
#: Largest number of images, and of pixels along the longer side of each, from which statistics are computed.
_IMAGES: Final = 100
_SIDE: Final = 160


def need_encoder() -> str:
    """Return the path of an ffmpeg with libx264.

    Raises:
        ImportError: The extra ``video`` is missing.
    """
    ffmpeg = find_ffmpeg()
    if ffmpeg is None:
        raise ImportError(f"Videos of a LeRobot dataset need an H.264 encoder: {install_hint('video')}.")
    return ffmpeg


def write_video(
    path: Path, open: Callable[..., RGBDSource], task: Task, frames: npt.NDArray[np.int64], fps: float
) -> tuple[dict[str, Any], Statistics]:
    """Encode some frames of a recorded episode.

    Args:
        path: The file to write.
        open: Opens a recording, as that of ``Extraction``.
        task: The episode.
        frames: Indices of the frames, in order.
        fps: Frames per second.

    Returns:
        The entry of the video in ``features`` of ``meta/info.json``, and the statistics of its images.

    Raises:
        ValueError: A frame has no colour image, or another size than the first.
        OSError: The recording cannot be read, or the video cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    wanted = set(frames.tolist())
    sampled = set(frames[:: max(1, len(frames) // _IMAGES)].tolist())
    part = {} if task.frames is None else {"frames": task.frames}
    encoder: H264Encoder | None = None
    size, pixels = (0, 0), []
    try:
        with open(task.source, **part) as source:
            for i, moment in enumerate(read_moments(source, int(frames[-1]) + 1)):
                rgb = moment.frame.rgb
                if i not in wanted:
                    continue
                if rgb is None:
                    raise ValueError(f"{task.source}: frame {i} has no colour image for a video.")
                if encoder is None:
                    size = rgb.shape[1], rgb.shape[0]
                    encoder = H264Encoder(need_encoder(), path, size, fps, _RANDOM_ACCESS)
                elif rgb.shape[1::-1] != size:
                    raise ValueError(f"{task.source}: frame {i} has another size than the first; a video has only one.")
                encoder.add(rgb)
                if i in sampled:
                    step = -(-max(size) // _SIDE)
                    pixels.append(rgb[::step, ::step].reshape(-1, 3))
        assert encoder is not None
        encoder.finish()
    finally:
        if encoder is not None:
            encoder.abort()
    return _feature(size, fps), image_statistics(np.concatenate(pixels), len(pixels))


def _feature(size: tuple[int, int], fps: float) -> dict[str, Any]:
    width, height = size[0] + size[0] % 2, size[1] + size[1] % 2
    return {
        "dtype": "video",
        "shape": [height, width, 3],
        "names": ["height", "width", "channels"],
        "info": {
            "video.height": height,
            "video.width": width,
            "video.codec": "h264",
            "video.pix_fmt": "yuv420p",
            "video.is_depth_map": False,
            "video.fps": fps,
            "video.channels": 3,
            "has_audio": False,
        },
    }
