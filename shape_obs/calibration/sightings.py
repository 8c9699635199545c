"""Where a source sees the corners of markers, over several frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shape_obs.calibration.points import has_depth, marker_points
from shape_obs.camera import Intrinsics
from shape_obs.markers import find_markers
from shape_obs.source import EndOfSource, RGBDSource

Array = npt.NDArray[np.float64]
Place = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Sighting:
    """Corners in space.

    Args:
        places: (marker, corner) -> (3,) metres, camera frame: the median over the frames.
        intrinsics: Of the images.
        by_depth: Whether depth told the distance, of any of them, or the markers' size alone.
    """

    places: dict[Place, Array]
    intrinsics: Intrinsics
    by_depth: bool

    @property
    def markers(self) -> list[int]:
        """Ids of the markers seen."""
        return sorted({marker for marker, _ in self.places})


def sight(source: RGBDSource, frames: int, dictionary: str, size: float | None = None) -> Sighting:
    """Look at the markers that lie still before a camera.

    Args:
        source: Connected.
        frames: To look at, at most; a recording may have fewer.
        dictionary: Which markers to look for.
        size: Side of a marker's black square, metres; needed without depth.

    Raises:
        ValueError: No intrinsics, no markers in half of the frames, or neither depth nor size.
        SourceError: The source fails.
    """
    seen: dict[int, list[Array]] = {}
    blind: set[int] = set()
    intrinsics, by_depth, looked = source.intrinsics, False, 0
    if intrinsics is None:
        raise ValueError(f"{source.name} does not know its intrinsics: take a camera, or a recording of one.")
    while looked < frames:
        try:
            frame = source.read(timeout=5.0)
        except EndOfSource:
            break
        looked += 1
        if frame.rgb is None:
            raise ValueError(f"{source.name} has no colour images: markers cannot be seen in depth.")
        for marker, corners in find_markers(frame.rgb, dictionary).items():
            depth = frame.depth if frame.depth is not None and has_depth(corners, frame.depth) else None
            if depth is None and size is None:
                blind.add(marker)  # a marker in a hole of the depth does not stand in the way of the others
                continue
            by_depth = by_depth or depth is not None
            seen.setdefault(marker, []).append(marker_points(corners, intrinsics, depth, size))
    # What is seen in a frame or two is no marker, or one that something passes over.
    often = {marker: points for marker, points in seen.items() if 2 * len(points) >= looked}
    if not often and blind:
        told = ", ".join(map(str, sorted(blind)))
        raise ValueError(f"markers {told} are seen, but there is no depth on them: give the markers' size.")
    if not often:
        raise ValueError(f"no markers of {dictionary!r} in the {looked} frames of {source.name}.")
    places = {
        (marker, corner): np.asarray(np.median(np.stack(points), axis=0)[corner], np.float64)
        for marker, points in often.items()
        for corner in range(4)
    }
    return Sighting(places, intrinsics, by_depth)
