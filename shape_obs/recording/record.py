"""Record the frames of a source, and what it publishes with them, into a folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from itertools import chain
from pathlib import Path
from typing import Any, Literal

from shape_obs.frame import Frame
from shape_obs.recording.format import Moment, read_moments
from shape_obs.recording.writer import RecordingWriter, check_new_folder
from shape_obs.source import EndOfSource, RGBDSource, SourceError
from shape_obs.tracking.clock import Clock

Depth = Literal["auto", "yes", "no"]


@dataclass
class Recorded:
    """The outcome of a recording.

    Attributes:
        path: The folder or file.
        frames: Number of written frames.
        missed: Number of frames, by the source's frame numbers, that were never read.
        dropped: Number of frames that were read but not written, since the encoders or the disk were too slow.
        actions: Number of written frames that an action led to.
        seconds: Time from the first stamp to the last, as ``Clock`` measures it; 0 without stamps.
        stopped: ``"done"`` (a limit, or the end of the source), ``"interrupted"`` (Ctrl-C), or the message of an error.
    """

    path: Path
    frames: int = 0
    missed: int = 0
    dropped: int = 0
    actions: int = 0
    seconds: float = 0.0
    stopped: str = "done"

    def __post_init__(self) -> None:
        self._last: Frame | None = None
        self._clock = Clock()

    def count(self, frame: Frame) -> None:
        """Count a frame that was read; when the frame numbers restart, no frame counts as missed."""
        before, self._last = self._last, frame
        if before is not None and before.number is not None and frame.number is not None:
            self.missed += max(frame.number - before.number - 1, 0)
        if frame.stamp is not None:
            self._clock.tick(frame.stamp)
            self.seconds = self._clock.now

    def to_dict(self) -> dict[str, Any]:
        """Return the outcome as JSON values."""
        return {**{field.name: getattr(self, field.name) for field in fields(self)}, "path": str(self.path)}


def record(
    source: RGBDSource,
    path: str | Path,
    *,
    frames: int | None = None,
    seconds: float | None = None,
    depth: Depth = "auto",
    workers: int = 2,
    on_frame: Callable[[Moment], Any] | None = None,
) -> Recorded:
    """Record a source until a limit, its end, Ctrl-C, or the loss of the camera; recorded frames are kept.

    Actions, rewards, ends of episodes and the state of the robot are recorded if the source publishes them.

    Args:
        source: The source; it is connected if necessary.
        path: A folder that does not exist or is empty.
        frames: Largest number of frames.
        seconds: Largest duration by the stamps.
        depth: ``"auto"`` records depth if there is any, ``"yes"`` requires it, ``"no"`` leaves it out.
        workers: Number of threads that encode images.
        on_frame: Called with each frame, for a progress bar or a view; its arrays must not be changed.

    Raises:
        ValueError: A limit is out of range, or depth is required and missing.
        FileExistsError: The folder is not empty.
        OSError: A file cannot be written, as on a full disk; the message gives the number of complete frames.
        SourceError: The source cannot be opened, or has no frame.
    """
    check_new_folder(Path(path))
    source.connect()
    if depth == "yes" and not source.has_depth:
        raise ValueError(f"{source.name} has no depth to record; a {source.kind} source has only colour.")
    moments = read_moments(source, frames, seconds)
    # Read before the folder is made, so that a source without frames leaves nothing behind.
    first = next(moments, None)
    if first is None:
        raise EndOfSource(f"{source.name} has no frame.")
    recorded = Recorded(Path(path))
    with RecordingWriter(path, source, depth=source.has_depth and depth != "no", workers=workers) as writer:
        try:
            for moment in chain([first], moments):
                recorded.count(moment.frame)
                recorded.dropped += not writer.add(moment, wait=not source.live)
                if on_frame is not None:
                    on_frame(moment)
        except KeyboardInterrupt:
            recorded.stopped = "interrupted"
        except SourceError as error:
            recorded.stopped = str(error)
        writer.close(missed=recorded.missed, dropped=recorded.dropped, stopped=recorded.stopped)
    recorded.frames, recorded.actions = writer.frames, writer.actions
    return recorded
