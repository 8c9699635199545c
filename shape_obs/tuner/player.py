"""Frames of a source one after the other, again, or from another place."""

from __future__ import annotations

from collections import deque
from typing import Final, Protocol, runtime_checkable

from shape_obs.recording.format import Moment, read_moment
from shape_obs.source import EndOfSource, RGBDSource

_KEPT: Final = 90  # frames of a source that cannot go back, about 150 MB at 640 x 480 with depth


@runtime_checkable
class Seekable(Protocol):
    """A source of known length that can go to any of its frames."""

    def __len__(self) -> int:
        """Return the number of frames."""
        ...

    def seek(self, index: int) -> None:
        """Go to a frame, which ``read`` returns next."""
        ...


class Player:
    """Read a source, and go back in it.

    A recording is read again from any place. Of a camera or an environment the last frames are kept.

    Args:
        source: The source; it is connected by ``open``.
    """

    def __init__(self, source: RGBDSource) -> None:
        self.source = source
        self._kept: deque[Moment] = deque(maxlen=_KEPT)
        self._at = -1  # of the frame shown: in the recording, or among the kept frames

    @property
    def seekable(self) -> Seekable | None:
        """The source if it can go to any frame; else None."""
        return self.source if isinstance(self.source, Seekable) and len(self.source) else None

    @property
    def position(self) -> int:
        """Index of the frame that was read last, from 0; -1 before the first."""
        return self._at

    @property
    def length(self) -> int:
        """How many frames there are to choose from."""
        source = self.seekable
        return len(self._kept) if source is None else len(source)

    def open(self) -> None:
        """Connect the source, unless it is connected; raise as ``source.connect`` does."""
        self.source.connect()

    def close(self) -> None:
        """Disconnect the source; the frames that were kept stay."""
        self.source.disconnect()

    def next(self, timeout: float) -> Moment:
        """Return the next frame: of a recording, of the kept frames, or a new one; raise as ``source.read`` does."""
        if self.seekable is None and self._at + 1 < len(self._kept):
            self._at += 1
            return self._kept[self._at]
        moment = read_moment(self.source, timeout)
        self._at += 1
        if self.seekable is None:
            self._kept.append(moment)
            self._at = len(self._kept) - 1
        return moment

    def go(self, index: int) -> Moment:
        """Return a frame by its index; the nearest one where there is none.

        Raises:
            SourceError: It cannot be read.
            EndOfSource: There is no frame.
        """
        index = min(max(index, 0), self.length - 1)
        if index < 0:
            raise EndOfSource("there is no frame yet.")
        source = self.seekable
        if source is None:
            self._at = index
            return self._kept[index]
        source.seek(index)
        self._at = index - 1
        return self.next(1.0)

    def skip(self) -> bool:
        """Pass over a frame of a recording that cannot be read; return whether there is one after it."""
        self._at += 1
        source = self.seekable
        if source is None or self._at + 1 >= len(source):
            return False
        source.seek(self._at + 1)
        return True

    def to_newest(self) -> None:
        """Continue with new frames of a camera rather than with those kept."""
        if self.seekable is None:
            self._at = len(self._kept) - 1
