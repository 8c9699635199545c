"""Recording: a folder that ``shape-obs record`` wrote, as it was or as far as it came."""

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
    camera_from_dict,
    read_known,
    restore,
)
from shape_obs.source import BadRecording
from shape_obs.utils.documents import parse_json, read_json


class Recording:
    """A recorded folder.

    Of an interrupted recording all whole frames are there: a partial last line, and last frames whose files are not
    whole, are left out, and ``warning`` says so.

    Args:
        path: The folder.

    Attributes:
        path: The folder.
        camera: Of all frames, but for those that tell their own.
        serial: The camera's serial number, where there was one.
        source: ``kind`` and ``name`` of the source that was recorded.
        has_depth: Whether frames carry depth.
        warning: What is missing; empty if nothing is.
        ended: What the last line told, such as how many frames were dropped; empty after an interruption.

    Raises:
        BadRecording: It is none, or damaged; the message names the file.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        content = self._read_camera_file()
        try:
            self.camera: CameraModel | None = camera_from_dict(content)
            head = read_known(CameraFile, content)
        except (KeyError, ValueError, TypeError) as error:
            raise BadRecording(f"{self.path / CAMERA_FILE}: damaged: {error!r}") from error
        self.source: Mapping[str, str] = head.source
        self.has_depth, self.serial = head.depth, head.serial
        self._lines, self.ended, partial = self._read_lines()
        self.warning = ""
        if not self.ended:
            lost = self._leave_out_damaged_end() + partial
            self.warning = f"{self.path}: the recording was interrupted; its {len(self)} whole frames are read" + (
                f", the last {lost} left out." if lost else "."
            )
        elif self.ended.get("frames") != len(self):
            raise BadRecording(
                f"{self.path / FRAMES_FILE}: {len(self)} frames, but its end speaks of {self.ended.get('frames')}."
            )
        if not self._lines:
            raise BadRecording(f"{self.path}: the recording holds no whole frame.")

    def __len__(self) -> int:
        return len(self._lines)

    def __getitem__(self, index: int) -> Moment:
        """Read a moment as it was recorded, to the bit.

        Raises:
            BadRecording: Its line is damaged, or one of its files is missing or damaged.
            IndexError: There are not so many.
        """
        line = self._lines[index]
        rgb = None if line.rgb is None else restore(self.path, "rgb", line.rgb)
        depth = None if line.depth is None else restore(self.path, "depth", line.depth)
        try:
            camera = self.camera if line.camera is None else camera_from_dict(line.camera)
            return Moment(Frame(rgb, depth, camera, line.stamp, line.received, line.number), line.anchors, line.episode)
        except (KeyError, ValueError, TypeError) as error:
            where = f"{self.path / FRAMES_FILE}, line {range(len(self))[index] + 1}"
            raise BadRecording(f"{where}: damaged: {error!r}") from error

    @property
    def episodes(self) -> list[int]:
        """Number of the episode that each frame belongs to."""
        return [line.episode for line in self._lines]

    def check(self) -> Iterator[str]:
        """Check every frame against its checksums: an empty text for each that is whole, else what is wrong with it."""
        return map(self._wrong_with, range(len(self)))

    def _wrong_with(self, index: int) -> str:
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
        """Return the frames' lines, the last line if the recording was ended, and how many partial lines there were."""
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
                # Cut by a kill, or filled with zeros by a file system that did not get to write it.
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
    """Return a frame's line, or the mapping that ends a recording; ValueError for anything else."""
    line = parse_json(text, "the line")
    if not isinstance(line, dict):
        raise ValueError(f"expected an object, got {text[:20]!r}")
    return line if END in line else read_known(FrameLine, line)
