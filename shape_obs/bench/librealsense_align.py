"""Alignment by librealsense itself, on arrays, for comparison with `Registration`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from shape_obs_envs.sources.realsense import SoftwareD455

_TIMEOUT: Final = 2000  # milliseconds


class LibrealsenseAlign:
    """Align depth to colour with ``rs.align``, through a software camera; colour keeps the lens distortion.

    Args:
        camera: The software camera, which must have no other reader.

    Raises:
        ImportError: librealsense is not installed.
    """

    def __init__(self, camera: SoftwareD455) -> None:
        from shape_obs_envs.sources.realsense.driver import librealsense

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
        """Return a frameset of two raw images, as a camera delivers it.

        Raises:
            TimeoutError: librealsense did not return the images.
        """
        self._camera.push_raw(colour_raw, depth_raw)
        there, frames = self._pipeline.try_wait_for_frames(_TIMEOUT)
        if not there or frames.size() < 2:
            raise TimeoutError("librealsense did not return the pair of images that was pushed.")
        return frames

    def align(self, frames: Any) -> Any:
        """Return the frameset with depth aligned by ``rs.align``."""
        return self._align.process(frames)

    def __call__(self, colour_raw: npt.NDArray[np.uint8], depth_raw: npt.NDArray[np.uint16]) -> npt.NDArray[np.uint16]:
        """Return depth ``(H, W)`` uint16, in the depth unit, aligned to the raw colour image."""
        return np.array(self.align(self.pair(colour_raw, depth_raw)).get_depth_frame().get_data())

    def close(self) -> None:
        """Stop the pipeline."""
        self._pipeline.stop()
