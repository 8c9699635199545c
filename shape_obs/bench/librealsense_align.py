"""LibrealsenseAlign: librealsense's own alignment, on arrays; what Registration is compared with."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs_envs.sources.realsense import SoftwareD455
from shape_obs_envs.sources.realsense.driver import librealsense

_TIMEOUT: Final = 2000  # milliseconds


class LibrealsenseAlign:
    """``rs.align`` to colour, behind a software camera; colour stays as it is, with the lens' distortion.

    Args:
        camera: Through which the images go; nobody else reads it.

    Raises:
        ImportError: librealsense is missing.
    """

    def __init__(self, camera: SoftwareD455) -> None:
        rs, geometry = librealsense(), camera.geometry
        self._camera, self._pipeline, config = camera, rs.pipeline(rs.context()), rs.config()
        for stream, pixels, lens in (
            (rs.stream.depth, rs.format.z16, geometry.depth),
            (rs.stream.color, rs.format.rgb8, geometry.colour),
        ):
            config.enable_stream(stream, lens.width, lens.height, pixels, camera.fps)
        self._pipeline.set_device(camera.device)
        self._pipeline.start(config)
        self._align = rs.align(rs.stream.color)

    def pair(self, colour_raw: npt.NDArray[np.uint8], depth_raw: npt.NDArray[np.uint16]) -> Any:
        """A frameset of two raw images, as a camera gives it.

        Raises:
            TimeoutError: librealsense did not give back what it was given.
        """
        self._camera.push_raw(colour_raw, depth_raw)
        there, frames = self._pipeline.try_wait_for_frames(_TIMEOUT)
        if not there or frames.size() < 2:
            raise TimeoutError("librealsense gave back no pair of the images that were pushed.")
        return frames

    def align(self, frames: Any) -> Any:
        """The frameset with depth aligned, by ``rs.align`` and nothing else."""
        return self._align.process(frames)

    def __call__(self, colour_raw: npt.NDArray[np.uint8], depth_raw: npt.NDArray[np.uint16]) -> npt.NDArray[np.uint16]:
        """Depth (H,W) uint16, in the depth unit, aligned to the raw colour image."""
        return np.array(self.align(self.pair(colour_raw, depth_raw)).get_depth_frame().get_data())

    def close(self) -> None:
        """Stop the pipeline."""
        self._pipeline.stop()
