"""Read a folder that ``shape-obs record`` wrote, also if the recording was interrupted."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from shape_obs.camera import CameraModel
from shape_obs.frame import Frame
from shape_obs.recording.format import (
    CAMERA_FILE,
    END,
    FORMAT,
    FRAMES_FILE,
    VERSION,
    CameraFile,
    FrameLine,
    Moment,
    RobotInfo,
    camera_from_dict,
    read_known,
)
from shape_obs.recording.images import restore
from shape_obs.source import BadRecording
from shape_obs.utils.documents import parse_json, read_json


class Recording:
    """A recorded folder.

    An interrupted recording has all complete frames. A partial last line, and last frames with incomplete files, are
    left out, and ``warning`` says so.

    Args:
        path: The folder.

    Attributes:
        path: The folder.
        camera: Camera of all frames, except for those that have their own.
        serial: Serial number of the camera, if known.
        source: ``kind`` and ``name`` of the recorded source.
        has_depth: Whether frames have depth.
        robot: Names of the values of the recorded actions and states; None if there are none.
        warning: What is missing; empty if the recording is complete.
        ended: Content of the last line, such as the number of dropped frames; empty after an interruption.

    Raises:
        BadRecording: The folder is not a recording, or is damaged; the message names the file.
    """

    path: Path
    camera: CameraModel | None
    serial: str | None
    source: Mapping[str, str]
    has_depth: bool
    robot: RobotInfo | None
    warning: str
    ended: dict[str, Any]

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        content = self._read_camera_file()
        try:
            self.camera = camera_from_dict(content)
            head = read_known(CameraFile, content)
        except (KeyError, ValueError, TypeError) as error:
            raise BadRecording(f"{self.path / CAMERA_FILE}: damaged: {error!r}") from error
        self.source = head.source
        self.has_depth, self.serial, self.robot = head.depth, head.serial, head.robot
        self._lines, self.ended, partial = self._read_lines()
        self.warning = ""
        if not self.ended:
            lost = self._leave_out_damaged_end() + partial
            self.warning = f"{self.path}: the recording was interrupted; its {len(self)} whole frames are read" + (
                f", the last {lost} left out." if lost else "."
            )
        elif self.ended.get("frames") != len(self):
            raise BadRecording(
                f"{self.path / FRAMES_FILE}: {len(self)} frames, but its last line counts {self.ended.get('frames')}."
            )
        if not self._lines:
            raise BadRecording(f"{self.path}: the recording holds no whole frame.")

    def __len__(self) -> int:
        return len(self._lines)

    def __getitem__(self, index: int) -> Moment:
        """Read a moment exactly as it was recorded.

        Raises:
            BadRecording: The line is damaged, or one of its files is missing or damaged.
            IndexError: The index is out of range.
        """
        line = self._lines[index]
        rgb = None if line.rgb is None else restore(self.path, "rgb", line.rgb)
        depth = None if line.depth is None else restore(self.path, "depth", line.depth)
        try:
            camera = self.camera if line.camera is None else camera_from_dict(line.camera)
            frame = Frame(rgb, depth, camera, line.stamp, line.received, line.number)
            return Moment(frame, line.anchors, line.episode, line.transition, line.state)
        except (KeyError, ValueError, TypeError) as error:
            where = f"{self.path / FRAMES_FILE}, line {range(len(self))[index] + 1}"
            raise BadRecording(f"{where}: damaged: {error!r}") from error

    @property
    def episodes(self) -> list[int]:
        """Number of the episode of each frame."""
        return [line.episode for line in self._lines]

    def check(self) -> Iterator[str]:
        """Verify the checksums of every frame; yield an error message for each, empty if the frame is intact."""
        return map(self._error_of, range(len(self)))

    def _error_of(self, index: int) -> str:
        try:
            self[index]
        except BadRecording as error:
            return str(error)
        return ""

    def _read_camera_file(self) -> Mapping[str, Any]:
        path = self.path / CAMERA_FILE
        try:
            head = read_json(path, "recording")
        except FileNotFoundError as error:
            raise BadRecording(f"{path}: missing; a recording has {CAMERA_FILE}, {FRAMES_FILE} and rgb/.") from error
        except (OSError, ValueError) as error:
            raise BadRecording(f"{path}: cannot be read: {error}") from error
        if not isinstance(head, Mapping) or head.get("format") != FORMAT:
            raise BadRecording(f"{path}: expected a file with format {FORMAT!r}.")
        if head.get("version") != VERSION:
            raise BadRecording(f"{path}: expected version {VERSION}, got {head.get('version')!r}: update shape-obs.")
        return head

    def _read_lines(self) -> tuple[list[FrameLine], dict[str, Any], int]:
        """Return the lines of the frames, the last line of a finished recording, and the number of partial lines."""
        path = self.path / FRAMES_FILE
        try:
            *whole, rest = path.read_bytes().split(b"\n")
        except OSError as error:
            raise BadRecording(f"{path}: cannot be read: {error.strerror}.") from error
        lines: list[FrameLine] = []
        for i, text in enumerate([*whole, rest] if rest else whole):
            try:
                line = _line(text)
            except ValueError as error:
                # Cut off when the process was killed, or filled with zeros by a file system that lost power.
                if i + 1 >= len(whole):
                    return lines, {}, 1
                raise BadRecording(f"{path}, line {i + 1}: damaged: {error}") from error
            if not isinstance(line, FrameLine):
                return lines, line, 0
            lines.append(line)
        return lines, {}, 0

    def _leave_out_damaged_end(self) -> int:
        before = len(self)
        while self._lines:
            try:
                self[-1]
                break
            except BadRecording:
                self._lines.pop()
        return before - len(self)


def _line(text: bytes) -> FrameLine | dict[str, Any]:
    """Parse a frame's line, or the last line of a recording; raise ``ValueError`` for anything else."""
    line = parse_json(text, "the line")
    if not isinstance(line, dict):
        raise ValueError(f"expected an object, got {text[:20]!r}")
    return line if END in line else read_known(FrameLine, line)
