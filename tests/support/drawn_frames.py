"""A source of frames that a test has drawn, and the command line as a test calls it."""

from __future__ import annotations

import pytest

from shape_obs import CameraModel, Frame, Intrinsics
from shape_obs.cli import main
from shape_obs.source import EndOfSource, Source


class Frames(Source):
    """Frames that a test has drawn."""

    kind, name, live = "folder", "drawn", False

    def __init__(self, images, intrinsics: Intrinsics | None, depths=None):
        super().__init__()
        self._frames = list(zip(images, depths or [None] * len(images), strict=True))
        self._intrinsics, self.has_depth = intrinsics, depths is not None

    @property
    def serial(self) -> str:
        return "0123"

    @property
    def intrinsics(self) -> Intrinsics | None:
        return self._intrinsics

    def connect(self) -> None:
        self._left = list(self._frames)

    def disconnect(self) -> None:
        pass

    def read(self, timeout: float = 1.0, fresh: bool = False) -> Frame:
        if not self._left:
            raise EndOfSource("over")
        rgb, depth = self._left.pop(0)
        camera = None if self._intrinsics is None else CameraModel(self._intrinsics)
        return Frame(rgb, depth, camera, stamp=(len(self._frames) - len(self._left)) / 30)

    def read_latest(self, max_age: float = 0.1) -> Frame:
        return self.read()


def run(*words: object) -> int:
    with pytest.raises(SystemExit) as end:
        main([str(word) for word in words])
    return int(end.value.code or 0)
