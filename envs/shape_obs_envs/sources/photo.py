"""A single photo as a source of one frame."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from shape_obs.camera import CameraModel, Intrinsics
from shape_obs.extrinsics import Extrinsics
from shape_obs.frame import Frame
from shape_obs.source import BadRecording, EndOfSource
from shape_obs.utils.arrays import read_depth, read_image
from shape_obs_envs.sources.sequence import SequenceSource, check_index


class PhotoSource(SequenceSource):
    """The one frame of a photo, with depth if there is a file of it.

    Args:
        path: The image file.
        extrinsics: See ``Source``; has no effect without intrinsics.
        depth: A file of depth, aligned to the photo: a 16-bit PNG in millimetres, or ``.npy`` (uint16 mm, float m).
        intrinsics: (fx, fy, cx, cy) in pixels; None if unknown.

    Raises:
        BadRecording: By ``connect``: a file does not exist, or is no image.
    """

    kind: str = "photo"

    def __init__(
        self,
        path: str | Path,
        extrinsics: Extrinsics | str | Path | None = None,
        *,
        depth: str | Path | None = None,
        intrinsics: tuple[float, float, float, float] | None = None,
    ) -> None:
        super().__init__(str(path), extrinsics)
        self.path = Path(path)
        self._depth = None if depth is None else Path(depth)
        self._lens = intrinsics
        self._frame: Frame | None = None
        self._at = 0

    def __len__(self) -> int:
        """Return 1."""
        return 1

    @property
    def has_depth(self) -> bool:
        """Whether the photo comes with depth."""
        return self._depth is not None

    def connect(self) -> None:
        """Read the files."""
        if self._connected:
            return
        try:
            rgb = read_image(self.path)
            depth = None if self._depth is None else read_depth(self._depth)
            lens = None if self._lens is None else Intrinsics(rgb.shape[1], rgb.shape[0], *self._lens)
            self._frame = Frame(rgb, depth, None if lens is None else CameraModel(lens), number=0)
        except (ValueError, TypeError, OSError) as error:
            raise BadRecording(str(error)) from error
        self._at, self._connected = 0, True

    def seek(self, index: int) -> None:
        """Go to a frame, which ``read`` returns next; see ``FolderSource``."""
        self._check_connected()
        check_index(index, 1, self.name)
        self._at = index

    def _next(self) -> Frame:
        if self._at:
            raise EndOfSource(f"{self.path}: end of its one frame.")
        assert self._frame is not None
        self._at = 1
        return replace(self._frame, camera=self.camera)

    def _known_camera(self) -> CameraModel | None:
        return None if self._frame is None else self._frame.camera
