"""Things that lie about: boxes, cylinders, balls and sticks beside the workspace, and flat ones within it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.randomization.colours import draw_other
from shape_obs_envs.mujoco.randomization.factor import Factor, Scene, choose
from shape_obs_envs.mujoco.randomization.props import colour, hide, prop, shape
from shape_obs_envs.mujoco.scene import camera_model

Array = NDArray[np.float64]
_NAME: Final = "distractor"
_KINDS: Final = ("box", "cylinder", "sphere", "capsule", "stick")
_TRIES: Final = 40
_GAP: Final = 0.015  # between a flat thing and the object [m]
_LYING: Final = (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0)  # an upright cylinder laid along x


@dataclass(frozen=True)
class Distractors(Factor):
    """What lies about. It has no hue of the object's family, and nothing touches it: contacts are off.

    Tall things stand where the object never comes, so that they never hide it. Flat ones, lower than the object's
    edge, may lie where it comes later.

    Attributes:
        most: Largest number of things; from none to so many are drawn.
        flat: Probability that a thing is a flat one.
        size: Smallest and largest half length of a thing [m].
        height: Largest height of a tall thing [m].
    """

    most: int = 4
    flat: float = 0.4
    size: tuple[float, float] = (0.012, 0.05)
    height: float = 0.05

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check(most=(0, 12), flat=(0, 1), height=(0.005, 0.1))
        if not 0.005 <= self.size[0] <= self.size[1] <= 0.1:
            raise ValueError(f"distractors.size: expected two sizes within 0.005 ... 0.1 m, got {self.size}.")

    def bodies(self) -> str:
        """MJCF of as many things as there can be, unseen."""
        return "".join(prop(f"{_NAME}{i}_", 1) for i in range(self.most))

    def apply(self, rng: np.random.Generator, scene: Scene) -> dict[str, Any]:
        """Draw things and lay them down, where there is room."""
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
            kind, size, quat, up = self._form(rng, scene.body.underlay if low else self.height, low)
            around = float(np.hypot(*size[:2])) if kind == "box" else max(size)
            place = _find_place(rng, scene, around, taken, low)
            if place is None:
                continue
            taken.append(np.array([*place, around]))
            rgb, turn = draw_other(rng, scene.hue).rgb, rng.uniform(-np.pi, np.pi)
            shape(model, geom, kind, size, quat=quat)
            colour(model, geom, rgb)
            scene.data.mocap_pos[mocap] = [*place, up]
            scene.data.mocap_quat[mocap] = np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2)
            drawn.append({"kind": kind, "size": size, "position": [*place.tolist(), up], "colour": list(rgb)})
        return {"things": drawn}

    def _form(self, rng: np.random.Generator, height: float, low: bool) -> tuple[str, list[float], Any, float]:
        """Kind, size [m], quaternion and height of the middle [m] of a thing that is no higher than `height` [m]."""
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


def _find_place(rng: np.random.Generator, scene: Scene, around: float, taken: list[Array], low: bool) -> Array | None:
    """A place (2,) [m] in view, or half in view, for a thing of radius `around` [m]; None where there is no room."""
    intrinsics = scene.camera.intrinsics
    view = camera_model(scene.camera, scene.model, scene.data)
    transform = view.transform_camera_to_base
    assert transform is not None
    pixels = rng.uniform(-0.06, 1.06, (_TRIES, 2)) * (intrinsics.width, intrinsics.height)
    rays = intrinsics.rays(pixels) @ transform[:3, :3].T
    eye = transform[:3, 3]
    places = (eye + rays * (-eye[2] / rays[:, 2:]))[:, :2]
    free = np.ones(_TRIES, bool)
    for x, y, radius in taken:
        free &= np.hypot(*(places - (x, y)).T) > around + radius
    if low:
        points = scene.points()[:, :2]
        apart = np.linalg.norm(places[:, None] - points, axis=2).min(axis=1)
        free &= apart > around + _GAP + _spacing(points) / 2
    else:
        (x0, y0, _), (x1, y1, _) = scene.reach
        outside = np.maximum(np.maximum((x0, y0) - places, places - (x1, y1)), 0)
        free &= np.hypot(*outside.T) > around
    return places[np.argmax(free)] if free.any() else None


def _spacing(points: Array) -> float:
    """How far points (n, 2) are from their nearest neighbours at most [m]."""
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    np.fill_diagonal(apart, np.inf)
    return float(apart.min(axis=1).max())
