"""Distractor ropes: ropes of the object's colour on the table, which lie over it and over each other."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.bodies.chain import Chain
from shape_obs_envs.mujoco.randomization.factors import Scene
from shape_obs_envs.mujoco.randomization.props import hide, prop_body, set_form, show
from shape_obs_envs.mujoco.scene import mujoco

Array = NDArray[np.float64]

_NAME: Final = "distractor_rope"
_LINKS: Final = 24
_LENGTH: Final = 0.25, 0.5  # metres
_THICKNESS: Final = 0.8, 1.2  # of the object's
#: Steepest slope of a rope that lies over another one.
_SLOPE: Final = 0.5
#: Largest fraction of the object that one rope hides at the start.
_COVER: Final = 0.15
_POINTS: Final = 100  # of the object, to lie over
_TRIES: Final = 40


class DistractorRopes:
    """Ropes of the object's colour, fixed in the plane, whose heights follow the object below them; no contacts.

    Args:
        scene: The scene, with a rope on the table as its object.
        most: Largest number of ropes, for which ``bodies`` were added to the model.
    """

    def __init__(self, scene: Scene, most: int) -> None:
        assert isinstance(scene.body, Chain)
        self._scene, self._chain = scene, scene.body
        model = scene.model
        self._geoms = [int(model.body(f"{_NAME}{i}_").geomadr[0]) + np.arange(_LINKS) for i in range(most)]
        self._lines: list[tuple[Array, float]] = []

    @staticmethod
    def bodies(most: int) -> str:
        """Return MJCF of the largest number of ropes, invisible."""
        return "".join(prop_body(f"{_NAME}{i}_", _LINKS) for i in range(most))

    @staticmethod
    def suit(scene: Scene) -> bool:
        """Return whether the object is a rope on the table, over which others can lie."""
        return isinstance(scene.body, Chain)

    def draw(self, rng: np.random.Generator) -> list[dict[str, Any]]:
        """Draw number, size and places of the ropes, and lay them; return the plain values."""
        scene, chain = self._scene, self._chain
        model, drawn = scene.model, []
        for geoms in self._geoms:
            hide(model, geoms)
        self._lines = []
        colour = model.geom_rgba[model.geom("link0").id, :3]
        for geoms in self._geoms[: int(rng.integers(len(self._geoms) + 1))]:
            radius, length = chain.spec.radius * rng.uniform(*_THICKNESS), rng.uniform(*_LENGTH)
            line = self._find_line(rng, radius, length - 2 * radius)
            if line is None:
                continue
            self._lines.append((line, radius))
            for geom in geoms:
                set_form(model, int(geom), "capsule", (radius, length / _LINKS / 2))
            show(model, geoms, colour)
            drawn.append({"radius": radius, "length": length, "line": line.tolist()})
        self.advance()
        return drawn

    def advance(self) -> None:
        """Lift the ropes over the object and over each other, after the physics."""
        object_ = self._chain.points(np.linspace(0, 1, _POINTS))
        below = [(object_, self._chain.spec.radius)]
        for geoms, (line, radius) in zip(self._geoms, self._lines, strict=False):
            axis = np.column_stack([line, heights_over(line, radius, below)])
            below.append((axis, radius))
            self._set_axis(geoms, axis, radius)
        mujoco.mj_kinematics(self._scene.model, self._scene.data)

    def _set_axis(self, geoms: NDArray[Any], axis: Array, radius: float) -> None:
        """Set the capsules ``geoms`` ``(links,)`` of a rope along its axis ``(links + 1, 3)``."""
        model, ways = self._scene.model, np.diff(axis, axis=0)
        half = np.linalg.norm(ways, axis=1) / 2
        model.geom_pos[geoms] = (axis[:-1] + axis[1:]) / 2
        model.geom_size[geoms, 1], model.geom_rbound[geoms] = half, half + radius
        for geom, way in zip(geoms, ways, strict=True):
            mujoco.mju_quatZ2Vec(model.geom_quat[geom], way / np.linalg.norm(way))

    def _find_line(self, rng: np.random.Generator, radius: float, length: float) -> Array | None:
        """Find an axis ``(links + 1, 2)`` in metres that hides neither end of the object, and little of it, or None."""
        (x0, y0, _), (x1, y1, _) = self._scene.reach
        s = (np.arange(_LINKS) + 0.5) / _LINKS
        near = radius + self._chain.spec.radius
        points, ends = self._chain.points(np.linspace(0, 1, _POINTS))[:, :2], self._chain.landmarks()[:, :2]
        for _ in range(_TRIES):
            headings = rng.uniform(-np.pi, np.pi) + rng.uniform(-1, 1) * np.cos(np.pi * s)
            headings += rng.uniform(-0.6, 0.6) * np.sin(2 * np.pi * s)
            steps = length / _LINKS * np.column_stack([np.cos(headings), np.sin(headings)])
            line = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
            line += rng.uniform((x0, y0), (x1, y1)) - line.mean(axis=0)
            if (_gaps(points, line) < near).mean() <= _COVER and _gaps(ends, line).min() > near:
                return line
        return None


def heights_over(line: Array, radius: float, below: list[tuple[Array, float]]) -> Array:
    """Return heights ``(N,)`` in metres of the axis of a rope that lies over others.

    Args:
        line: The rope's axis seen from above, ``(N, 2)`` in metres.
        radius: Its radius in metres.
        below: Axes ``(P, 3)`` in metres of the ropes below it, and their radii.
    """
    heights = np.full(len(line), radius)
    for axis, other in below:
        gaps = np.linalg.norm(line[:, None] - axis[:, :2], axis=2)
        over = axis[:, 2] + other + radius - _SLOPE * np.maximum(gaps - other - radius, 0)
        heights = np.maximum(heights, over.max(axis=1))
    return heights


def _gaps(points: Array, line: Array) -> Array:
    """Return the distances ``(P,)`` in metres of points ``(P, 2)`` from the nearest vertex of a line ``(N, 2)``."""
    return np.linalg.norm(points[:, None] - line, axis=2).min(axis=1)
