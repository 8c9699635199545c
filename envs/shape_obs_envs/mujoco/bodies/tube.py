"""A skin over a chain of links, rendered in one call: thirty capsules would dominate OpenGL's time for a small image.

Rays and physics still use the geoms of the links; OpenGL omits them if there is a tube.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Name of the skin, of its texture and of its material, after the prefix of its rope.
TUBE = "tube"
_TEXELS = 512  # along the tube


class Station(NamedTuple):
    """A cross-section of a tube whose links are straight along x, with the first link's start at x = 0.

    Args:
        x: Position in metres.
        scale: Scale of the cross-section's profile; 0 closes the tube.
        links: Links to which it is bound, with equal weights.
    """

    x: float
    scale: float
    links: tuple[int, ...]


def rounded_ends(length: float, radius: float, last: int) -> tuple[list[Station], list[Station]]:
    """Return the stations of the hemispheres at the ends of links 0 ... ``last``, whose axis is ``length`` long."""
    angles = np.radians([90.0, 70.0, 45.0, 20.0])
    start = [Station(-radius * np.sin(a), float(np.cos(a)), (0,)) for a in angles]
    end = [Station(length + radius * np.sin(a), float(np.cos(a)), (last,)) for a in angles[::-1]]
    return start, end


class Tube(NamedTuple):
    """A tube whose links are straight along x.

    Args:
        stations: Cross-sections from end to end.
        profile: Closed cross-section about the axis, ``(K, 2)``, y and z in metres, counter-clockwise seen from +x. A
            repeated point is an edge: its two faces are shaded separately.
        height: Height of the axis above the table in metres.
        link: Length of a link in metres.
        origin: Start ``(2,)`` of the first link in the model's initial configuration, x and y in metres.
    """

    stations: Sequence[Station]
    profile: Array
    height: float
    link: float
    origin: Array

    @property
    def vertices(self) -> Array:
        """Vertices ``(S, K, 3)`` in metres, station by station."""
        height = self.height
        rings = np.array([[(s.x, s.scale * y, s.scale * z + height) for y, z in self.profile] for s in self.stations])
        rings[..., :2] += self.origin
        return rings

    @property
    def carriers(self) -> list[int]:
        """Links to which the tube is bound, in order."""
        return sorted({index for station in self.stations for index in station.links})

    @property
    def hinges(self) -> Array:
        """Starts ``(carriers, 3)`` of these links in metres."""
        starts = self.origin[0] + np.array(self.carriers) * self.link
        return np.column_stack([starts, np.full(len(starts), self.origin[1]), np.full(len(starts), self.height)])


def tube_skin(tube: Tube, links: int, rgba: Sequence[float], prefix: str = "") -> str:
    """Return MJCF of a skin over bodies named "link0", "link1", ...

    Args:
        tube: Form of the skin.
        links: Number of links; the texture covers them once.
        rgba: Colour.
        prefix: Prefix of the names of the bodies, the skin, its texture and its material.
    """
    name = prefix + TUBE
    k, stations, rings = len(tube.profile), tube.stations, tube.vertices
    ring, corner = np.meshgrid(np.arange(len(stations) - 1), np.arange(k), indexing="ij")
    a, b = ring * k + corner, ring * k + (corner + 1) % k
    faces = np.concatenate([np.stack([a, b, b + k], axis=-1), np.stack([a, b + k, a + k], axis=-1)]).reshape(-1, 3)
    corners = rings.reshape(-1, 3)[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    faces = faces[area > 1e-12]
    along = np.array([s.x for s in stations]) / (links * tube.link)
    places = np.stack([np.repeat(along, k), np.full(len(stations) * k, 0.5)], axis=1)
    bones = []
    for index, hinge in zip(tube.carriers, tube.hinges, strict=True):
        carried = [(i, 1 / len(s.links)) for i, s in enumerate(stations) if index in s.links]
        ids = np.concatenate([np.arange(i * k, (i + 1) * k) for i, _ in carried])
        weights = np.repeat([weight for _, weight in carried], k)
        bones.append(
            f'<bone body="{prefix}link{index}" bindpos="{_numbers(hinge)}" bindquat="1 0 0 0" vertid="{_numbers(ids)}" '
            f'vertweight="{_numbers(weights)}"/>'
        )
    return (
        f'<asset><texture name="{name}" type="2d" builtin="flat" rgb1="1 1 1" width="{_TEXELS}" height="1"/>'
        f'<material name="{name}" texture="{name}" specular="0" shininess="0"/></asset>'
        f'<deformable><skin name="{name}" rgba="{_numbers(rgba)}" vertex="{_numbers(rings.ravel())}" '
        f'texcoord="{_numbers(places.ravel())}" face="{_numbers(faces.ravel())}">{"".join(bones)}</skin></deformable>'
    )


def reshape_tube(model: Any, tube: Tube, prefix: str = "") -> None:
    """Change the skin of a compiled model to the form of another tube over the same links."""
    skin = model.skin(prefix + TUBE)
    start = int(model.skin_vertadr[skin.id])
    model.skin_vert[start : start + int(model.skin_vertnum[skin.id])] = tube.vertices.reshape(-1, 3)
    start = int(model.skin_boneadr[skin.id])
    model.skin_bonebindpos[start : start + int(model.skin_bonenum[skin.id])] = tube.hinges


def set_tube_colours(model: Any, rgb: Sequence[float], tones: NDArray[Any], prefix: str = "") -> None:
    """Set the colours of the skin of a compiled model.

    Args:
        model: The model.
        rgb: Colour, 0 ... 1.
        tones: Factor of the colour for each link, ``(links,)``, 0 ... 1.
        prefix: Prefix of the name of the skin.
    """
    name = prefix + TUBE
    link = (np.arange(_TEXELS) + 0.5) * len(tones) / _TEXELS
    start, skin = int(model.texture(name).adr[0]), model.skin(name).id
    model.tex_data[start : start + 3 * _TEXELS] = np.repeat(np.rint(255 * tones[link.astype(int)]), 3)
    model.skin_rgba[skin, :3], model.skin_matid[skin] = rgb, model.material(name).id


def _numbers(values: Sequence[float] | NDArray[np.generic]) -> str:
    return " ".join(f"{value:.9g}" for value in values)
