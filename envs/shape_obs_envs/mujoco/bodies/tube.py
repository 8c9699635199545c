"""A skin over a chain of links, so that it is drawn with one call: thirty capsules take OpenGL most of a small picture.

The links' own geoms stay what rays meet and what the physics weigh; where there is a tube OpenGL leaves them out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Name of the skin.
TUBE = "tube"


class Station(NamedTuple):
    """A cross-section of a tube while its links lie straight along x, the first link's start at x = 0.

    Args:
        x: Where it is [m].
        scale: Of the cross-section's profile; 0 closes the tube.
        links: The links that carry it, to equal parts.
    """

    x: float
    scale: float
    links: tuple[int, ...]


def rounded_ends(length: float, radius: float, last: int) -> tuple[list[Station], list[Station]]:
    """Stations of the two half balls at the ends of a chain of links 0 ... `last` whose axis is `length` long."""
    angles = np.radians([90.0, 70.0, 45.0, 20.0])
    start = [Station(-radius * np.sin(a), float(np.cos(a)), (0,)) for a in angles]
    end = [Station(length + radius * np.sin(a), float(np.cos(a)), (last,)) for a in angles[::-1]]
    return start, end


def tube_skin(
    stations: Sequence[Station], profile: Array, height: float, link: float, origin: Array, rgba: Sequence[float]
) -> str:
    """MJCF of a skin over bodies named "link0", "link1", ...

    Args:
        stations: From end to end.
        profile: (K, 2) y and z [m] of a cross-section about the axis, counter-clockwise as seen from +x, closed. A
            point that stands in it twice is an edge: its two faces are shaded apart.
        height: Of the axis above the table [m].
        link: Length of a link [m].
        origin: (2,) x, y [m] of the first link's start in the model's first configuration.
        rgba: Colour.
    """
    k = len(profile)
    rings = np.array([[(s.x, s.scale * y, s.scale * z + height) for y, z in profile] for s in stations])
    rings[..., :2] += origin
    ring, corner = np.meshgrid(np.arange(len(stations) - 1), np.arange(k), indexing="ij")
    a, b = ring * k + corner, ring * k + (corner + 1) % k
    faces = np.concatenate([np.stack([a, b, b + k], axis=-1), np.stack([a, b + k, a + k], axis=-1)]).reshape(-1, 3)
    corners = rings.reshape(-1, 3)[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    faces = faces[area > 1e-12]
    bones = []
    for index in sorted({index for station in stations for index in station.links}):
        carried = [(i, 1 / len(s.links)) for i, s in enumerate(stations) if index in s.links]
        ids = np.concatenate([np.arange(i * k, (i + 1) * k) for i, _ in carried])
        weights = np.repeat([weight for _, weight in carried], k)
        place = _numbers([origin[0] + index * link, origin[1], height])
        bones.append(
            f'<bone body="link{index}" bindpos="{place}" bindquat="1 0 0 0" vertid="{_numbers(ids)}" '
            f'vertweight="{_numbers(weights)}"/>'
        )
    return (
        f'<deformable><skin name="{TUBE}" rgba="{_numbers(rgba)}" vertex="{_numbers(rings.ravel())}" '
        f'face="{_numbers(faces.ravel())}">{"".join(bones)}</skin></deformable>'
    )


def _numbers(values: Sequence[float] | NDArray[np.generic]) -> str:
    return " ".join(f"{value:.9g}" for value in values)
