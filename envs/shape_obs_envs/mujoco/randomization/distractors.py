"""Distractors: boxes, cylinders, balls and sticks next to the workspace, and flat objects within it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.bodies.chain import Chain
from shape_obs_envs.mujoco.randomization.factors import Factor, Scene, choose, draw_other
from shape_obs_envs.mujoco.randomization.props import hide, prop_body, set_form, show
from shape_obs_envs.mujoco.scene import camera_model, mujoco

Array = NDArray[np.float64]
_NAME: Final = "distractor"
_KINDS: Final = ("box", "cylinder", "sphere", "capsule", "stick")
_TRIES: Final = 40
_GAP: Final = 0.015  # between a flat distractor and the object, in metres
_LYING: Final = (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0)  # an upright cylinder laid along x

_ROPE: Final = "distractor_rope"
_LINKS: Final = 24
_LENGTH: Final = 0.25, 0.5  # metres
_THICKNESS: Final = 0.8, 1.2  # of the object's
#: Steepest slope of a rope that lies over another one.
_SLOPE: Final = 0.5
#: Largest fraction of the object that one rope hides at the start.
_COVER: Final = 0.15
_POINTS: Final = 100  # of the object, to lie over


@dataclass(frozen=True)
class Distractors(Factor):
    """Variation of the objects on the table. Their hues are not near the object's, and they have no contacts.

    Tall distractors stand outside the object's reach and never occlude it. Flat ones, lower than the object's edge, may
    lie where the object moves later.

    Attributes:
        most: Largest number of distractors; their number is drawn from 0 to this.
        flat: Probability that a distractor is flat.
        size: Smallest and largest half length of a distractor in metres.
        height: Largest height of a tall distractor in metres.
        ropes: Largest number of ropes of the object's colour, which lie over it; ignored unless the object is a single
            rope on the table.
    """

    factor: ClassVar[str] = "distractors"
    most: int = 4
    flat: float = 0.4
    size: tuple[float, float] = (0.012, 0.05)
    height: float = 0.05
    ropes: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check(most=(0, 12), flat=(0, 1), height=(0.005, 0.1), ropes=(0, 4))
        if not 0.005 <= self.size[0] <= self.size[1] <= 0.1:
            raise ValueError(f"distractors.size: expected two sizes within 0.005 ... 0.1 m, got {self.size}.")

    def bodies(self) -> str:
        """Return MJCF of the largest number of distractors, invisible."""
        return "".join(prop_body(f"{_NAME}{i}_", 1) for i in range(self.most)) + DistractorRopes.bodies(self.ropes)

    def apply(self, rng: np.random.Generator, scene: Scene) -> dict[str, Any]:
        """Draw the distractors and place them where there is room."""
        model, drawn = scene.model, []
        taken: list[Array] = []
        count = int(rng.integers(0, self.most + 1))
        for i in range(self.most):
            body = model.body(f"{_NAME}{i}_")
            geom, mocap = int(body.geomadr[0]), int(body.mocapid[0])
            hide(model, geom)
            if i >= count:
                continue
            low = scene.body.underlay > 0 and rng.random() < self.flat
            kind, size, quat, up = self._draw_form(rng, scene.body.underlay if low else self.height, low)
            radius = float(np.hypot(*size[:2])) if kind == "box" else max(size)
            place = _find_place(rng, scene, radius, taken, low)
            if place is None:
                continue
            taken.append(np.array([*place, radius]))
            rgb, turn = draw_other(rng, scene.hue).rgb, rng.uniform(-np.pi, np.pi)
            set_form(model, geom, kind, size, quat=quat)
            show(model, geom, rgb)
            scene.data.mocap_pos[mocap] = [*place, up]
            scene.data.mocap_quat[mocap] = np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2)
            drawn.append({"kind": kind, "size": size, "position": [*place.tolist(), up], "colour": list(rgb)})
        return {"things": drawn}

    def _draw_form(self, rng: np.random.Generator, height: float, low: bool) -> tuple[str, list[float], Any, float]:
        """Draw kind, size, quaternion and height of the centre of a distractor no higher than ``height``, in metres."""
        kind = choose(rng, _KINDS[:2] if low else _KINDS)
        long, wide = rng.uniform(*self.size), rng.uniform(*self.size)
        up = height / 2 if low else rng.uniform(0.3, 1.0) * height / 2
        upright = (1.0, 0.0, 0.0, 0.0)
        if kind == "box":
            return kind, [long, wide, up], upright, up
        if kind == "cylinder":
            return kind, [long, up], upright, up
        if kind == "sphere":
            return kind, [up], upright, up
        thick = min(up, 0.012 + 0.2 * long)
        return ("cylinder" if kind == "stick" else kind), [thick, long], _LYING, thick


def _find_place(rng: np.random.Generator, scene: Scene, radius: float, taken: list[Array], low: bool) -> Array | None:
    """Find a place ``(2,)`` in metres, at least half in view, for an object of this radius; None if there is none."""
    intrinsics = scene.camera.intrinsics
    view = camera_model(scene.camera, scene.model, scene.data)
    transform = view.transform_camera_to_base
    assert transform is not None
    pixels = rng.uniform(-0.06, 1.06, (_TRIES, 2)) * (intrinsics.width, intrinsics.height)
    rays = intrinsics.rays(pixels) @ transform[:3, :3].T
    eye = transform[:3, 3]
    places = (eye + rays * (-eye[2] / rays[:, 2:]))[:, :2]
    free = rays[:, 2] < 0  # a camera that is nearly level also sees what is above the table
    for x, y, other in taken:
        free &= np.hypot(*(places - (x, y)).T) > radius + other
    if low:
        points = scene.points()[:, :2]
        apart = np.linalg.norm(places[:, None] - points, axis=2).min(axis=1)
        free &= apart > radius + _GAP + _spacing(points) / 2
    else:
        (x0, y0, _), (x1, y1, _) = scene.reach
        outside = np.maximum(np.maximum((x0, y0) - places, places - (x1, y1)), 0)
        free &= np.hypot(*outside.T) > radius
    return places[np.argmax(free)] if free.any() else None


def _spacing(points: Array) -> float:
    """Return the largest distance in metres of a point of ``(n, 2)`` to its nearest neighbour."""
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    np.fill_diagonal(apart, np.inf)
    return float(apart.min(axis=1).max())


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
        self._geoms = [int(model.body(f"{_ROPE}{i}_").geomadr[0]) + np.arange(_LINKS) for i in range(most)]
        self._lines: list[tuple[Array, float]] = []

    @staticmethod
    def bodies(most: int) -> str:
        """Return MJCF of the largest number of ropes, invisible."""
        return "".join(prop_body(f"{_ROPE}{i}_", _LINKS) for i in range(most))

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
