"""record: from a source into a folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from itertools import chain
from pathlib import Path
from typing import Any, Literal

from shape_obs.frame import Frame
from shape_obs.recording.format import read_moments
from shape_obs.recording.writer import RecordingWriter, check_new_folder
from shape_obs.source import EndOfSource, RGBDSource, SourceError

Depth = Literal["auto", "yes", "no"]


@dataclass
class Recorded:
    """What became of a recording.

    Attributes:
        path: The folder or file.
        frames: Written.
        missed: By the source's own count: lost on the way, or because nobody read in time.
        dropped: Frames that were read but found the encoders or the disk too slow.
        seconds: From the first stamp to the last; 0 without stamps.
        stopped: Why it ended: ``"done"`` (a limit, or the source's end), ``"interrupted"`` (Ctrl-C), or the message of
            an error.
    """

    path: Path
    frames: int = 0
    missed: int = 0
    dropped: int = 0
    seconds: float = 0.0
    stopped: str = "done"

    def __post_init__(self) -> None:
        self._last: Frame | None = None

    def saw(self, frame: Frame) -> None:
        """Count a frame that was read; a source that begins to count anew missed none."""
        before, self._last = self._last, frame
        if before is None:
            return
        if before.number is not None and frame.number is not None:
            self.missed += max(frame.number - before.number - 1, 0)
        if before.stamp is not None and frame.stamp is not None:
            self.seconds += frame.stamp - before.stamp

    def to_dict(self) -> dict[str, Any]:
        """JSON-able values."""
        return {**{field.name: getattr(self, field.name) for field in fields(self)}, "path": str(self.path)}


def record(
    source: RGBDSource,
    path: str | Path,
    *,
    frames: int | None = None,
    seconds: float | None = None,
    depth: Depth = "auto",
    workers: int = 2,
    on_frame: Callable[[], Any] | None = None,
) -> Recorded:
    """Record a source until a limit, its end, or Ctrl-C. A camera that is lost ends it too: what is there is kept.

    Args:
        source: Is connected where it is not.
        path: A folder that does not exist or is empty.
        frames: How many at most.
        seconds: By the stamps.
        depth: ``"auto"`` records what there is, ``"yes"`` insists on it, ``"no"`` leaves it out.
        workers: Threads that encode images.
        on_frame: Called after each frame, for a progress bar.

    Raises:
        ValueError: A limit that is none, or no depth where it was insisted on.
        FileExistsError: The folder is not empty.
        OSError: A file cannot be written, as on a full disk; the message tells how many whole frames are kept.
        SourceError: The source cannot be opened, or not even its first frame came.
    """
    check_new_folder(Path(path))
    source.connect()
    if depth == "yes" and not source.has_depth:
        raise ValueError(f"{source.name} has no depth to record; a {source.kind} source gives colour alone.")
    moments = read_moments(source, frames, seconds)
    # Before the folder is made: a source that gives nothing leaves nothing behind.
    first = next(moments, None)
    if first is None:
        raise EndOfSource(f"{source.name} has no frame.")
    told = Recorded(Path(path))
    with RecordingWriter(path, source, depth=source.has_depth and depth != "no", workers=workers) as writer:
        try:
            for moment in chain([first], moments):
                told.saw(moment.frame)
                told.dropped += not writer.add(moment, wait=not source.live)
                if on_frame is not None:
                    on_frame()
        except KeyboardInterrupt:
            told.stopped = "interrupted"
        except SourceError as error:
            told.stopped = str(error)
        writer.close(missed=told.missed, dropped=told.dropped, stopped=told.stopped)
    told.frames = writer.frames
    return told
