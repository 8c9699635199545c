"""Corners of markers that a robot touches and a camera sees, and the files of touches."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.calibration.hand_eye import has_depth, marker_points
from shape_obs.camera import Intrinsics
from shape_obs.markers import find_markers
from shape_obs.source import EndOfSource, RGBDSource
from shape_obs.spec import Spec, SpecError
from shape_obs.utils.documents import parse_json
from shape_obs.utils.files import write_text

Array = npt.NDArray[np.float64]
#: The id of a marker, and the index of its corner.
MarkerCorner = tuple[int, int]

FIELDS: Final = ("marker", "corner", "x", "y", "z")
CORNERS: Final = ("top left", "top right", "bottom right", "bottom left")


@dataclass(frozen=True)
class Touch(Spec):
    """The position of a robot's tool tip when it touched the corner of a marker.

    Args:
        marker: The id of the marker.
        corner: 0...3: the marker's own top left, top right, bottom right, bottom left.
        x: x of the tool tip in metres, base frame.
        y: y of the tool tip in metres, base frame.
        z: z of the tool tip in metres, base frame.
    """

    marker: int
    corner: int
    x: float
    y: float
    z: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.corner not in range(4):
            raise SpecError(f"corner: expected 0 to 3 ({', '.join(CORNERS)}), got {self.corner}.")
        if not np.all(np.isfinite((self.x, self.y, self.z))):
            raise SpecError(f"x, y, z: expected finite metres, got {self.x}, {self.y}, {self.z}.")
        if max(abs(self.x), abs(self.y), abs(self.z)) > 10:
            raise SpecError(f"x, y, z: expected metres, got {self.x}, {self.y}, {self.z}; are they millimetres?")

    @property
    def name(self) -> str:
        """Description of the corner, for messages."""
        return f"marker {self.marker}, corner {self.corner} ({CORNERS[self.corner]})"


def read_touches(path: str | Path) -> list[Touch]:
    """Read a CSV file with the header ``marker,corner,x,y,z``, or a JSON list of such objects; metres, base frame.

    Raises:
        FileNotFoundError: There is no such file.
        SpecError: The message names the row and what is wrong with it.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise FileNotFoundError(f"{path}: no such touches file") from error
    except UnicodeDecodeError as error:
        raise SpecError(f"{path}: expected a CSV or JSON file of touches: {error}") from error
    rows = _json_rows(path, text) if path.suffix == ".json" else _csv_rows(path, text)
    if not rows:
        raise SpecError(f"{path}: holds no touches.")
    return [_touch(f"{path}: {number}", row) for number, row in rows]


def write_touches(path: str | Path, touches: Iterable[Touch]) -> None:
    """Write touches as CSV, completely or not at all."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(FIELDS)
    writer.writerows([touch.to_dict()[name] for name in FIELDS] for touch in touches)
    write_text(Path(path), text.getvalue())


def _touch(where: str, row: Any) -> Touch:
    try:
        return Touch.from_dict(row)
    except SpecError as error:
        raise SpecError(f"{where}: {error}") from error


def _json_rows(path: Path, text: str) -> list[tuple[str, Any]]:
    rows = parse_json(text, str(path))
    if not isinstance(rows, list):
        raise SpecError(f"{path}: expected a list of touches, got {type(rows).__name__}.")
    return [(f"touch {number}", row) for number, row in enumerate(rows, start=1)]


def _csv_rows(path: Path, text: str) -> list[tuple[str, Any]]:
    try:
        return _checked_rows(path, csv.DictReader(io.StringIO(text), skipinitialspace=True))
    except csv.Error as error:
        raise SpecError(f"{path}: expected a CSV file of touches: {error}") from error


def _checked_rows(path: Path, reader: csv.DictReader[str]) -> list[tuple[str, Any]]:
    if [name.strip() for name in reader.fieldnames or ()] != list(FIELDS):
        raise SpecError(f"{path}: expected the header {','.join(FIELDS)}, got {','.join(reader.fieldnames or ())}.")
    return [(f"line {reader.line_num}", _numbers(path, reader.line_num, row)) for row in reader]


def _numbers(path: Path, line: int, row: Mapping[Any, Any]) -> dict[str, float]:
    try:
        return {name.strip(): float(value) for name, value in row.items()}
    except (TypeError, ValueError, AttributeError) as error:
        given = ",".join(str(value) for value in row.values())
        raise SpecError(f"{path}: line {line}: expected five numbers ({','.join(FIELDS)}), got {given}.") from error


@dataclass(frozen=True, eq=False)
class Sighting:
    """The corners of markers as a camera sees them.

    Args:
        corners: Position of each corner in metres, camera frame: the median over the frames.
        intrinsics: The intrinsics of the images.
        by_depth: Whether depth was used for any corner, not only the size of the markers.
    """

    corners: dict[MarkerCorner, Array]
    intrinsics: Intrinsics
    by_depth: bool

    @property
    def markers(self) -> list[int]:
        """Ids of the visible markers."""
        return sorted({marker for marker, _ in self.corners})


def sight(source: RGBDSource, frames: int, dictionary: str, size: float | None = None) -> Sighting:
    """Locate the corners of markers that lie still in front of a camera.

    Args:
        source: A connected source.
        frames: Largest number of frames; a recording may have fewer.
        dictionary: The marker dictionary.
        size: Side of a marker's black square in metres; needed without depth.

    Raises:
        ValueError: There are no intrinsics, no marker is visible in half of the frames, or there is neither depth nor a
            size.
        SourceError: The source fails.
    """
    seen: dict[int, list[Array]] = {}
    blind: set[int] = set()
    intrinsics, by_depth, looked = source.intrinsics, False, 0
    if intrinsics is None:
        raise ValueError(f"{source.name} has no intrinsics: use a camera, or a recording of one.")
    while looked < frames:
        try:
            frame = source.read(timeout=5.0)
        except EndOfSource:
            break
        looked += 1
        if frame.rgb is None:
            raise ValueError(f"{source.name} has no colour images, which markers need.")
        for marker, pixels in find_markers(frame.rgb, dictionary).items():
            depth = frame.depth if frame.depth is not None and has_depth(pixels, frame.depth) else None
            if depth is None and size is None:
                blind.add(marker)  # other markers may have depth
                continue
            by_depth = by_depth or depth is not None
            seen.setdefault(marker, []).append(marker_points(pixels, intrinsics, depth, size))
    # A marker in a few frames only is a false detection, or something passed over it.
    often = {marker: points for marker, points in seen.items() if 2 * len(points) >= looked}
    if not often and blind:
        markers = ", ".join(map(str, sorted(blind)))
        raise ValueError(f"markers {markers} are visible, but have no depth: give the size of the markers.")
    if not often:
        raise ValueError(f"no markers of {dictionary!r} in the {looked} frames of {source.name}.")
    corners = {
        (marker, corner): np.asarray(np.median(np.stack(points), axis=0)[corner], np.float64)
        for marker, points in often.items()
        for corner in range(4)
    }
    return Sighting(corners, intrinsics, by_depth)
