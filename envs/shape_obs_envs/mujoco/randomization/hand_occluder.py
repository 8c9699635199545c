"""A hand that comes between camera and object, covers a part of the object, and leaves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.randomization.factors import FAMILY, GREY, Colour, Factor, Scene, choose, hue_distance
from shape_obs_envs.mujoco.randomization.props import hide, prop_body, set_form, show
from shape_obs_envs.mujoco.scene import CAMERA, cast_rays, mujoco

Array = NDArray[np.float64]

_HAND: Final = "hand"
#: Geom group of the hand, so that rays can be cast at it alone.
_GROUP: Final = 2
_PALM, _FOREARM, _FINGERS = 0, 1, 2  # the first of the fingers' geoms, two for each of five
_GEOMS: Final = _FINGERS + 10
_FAR: Final = 0.55  # from its waiting place, out of view, to its target, in metres
_BACK: Final = 0.015  # step by which it retreats if it would cover too much, in metres

# Skin from pale to dark, and gloves.
_SKINS: Final = (
    Colour(10, 0.30, 0.92), Colour(9, 0.40, 0.80), Colour(9, 0.48, 0.62), Colour(8, 0.52, 0.42), Colour(8, 0.50, 0.28),
    Colour(0, 0.02, 0.95), Colour(0, 0.02, 0.15), Colour(105, 0.65, 0.75), Colour(60, 0.55, 0.60),
    Colour(23, 0.70, 0.85), Colour(140, 0.45, 0.55),
)  # fmt: skip
# Roots of thumb, index, middle, ring and little finger, x forward and y left, right hand palm down; lengths in metres.
_ROOTS: Final = ((-0.120, 0.034), (-0.075, 0.029), (-0.070, 0.009), (-0.073, -0.011), (-0.082, -0.030))
_LENGTHS: Final = (0.060, 0.070, 0.078, 0.072, 0.056)
_SPREAD: Final = (0.75, 0.14, 0.03, -0.08, -0.20)  # heading of each finger in radians


@dataclass(frozen=True)
class Hand(Factor):
    """Variation of a hand, in the colour of skin or of a glove, that reaches for a point of the object.

    Attributes:
        probability: Probability that it comes in an episode.
        cover: Largest fraction of the object's points that it covers, 0 ... 1; it retreats if it would cover more.
        spare: Whether it avoids the landmarks of the object: the ends of a rope, the corners of a cloth, and enough
            of a band's width to see that it is closed. See docs/how-to/randomise-a-simulation.md.
        latest: Last step in which it may start.
        stay: Smallest and largest number of steps that it stays.
        speed: Smallest and largest distance per step in metres.
        height: Smallest and largest gap in metres to the point of the object that is nearest to the camera.
    """

    factor: ClassVar[str] = "hand"
    probability: float = 0.5
    cover: float = 0.2
    spare: bool = True
    latest: int = 20
    stay: tuple[int, int] = (3, 12)
    speed: tuple[float, float] = (0.04, 0.08)
    height: tuple[float, float] = (0.02, 0.06)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check(probability=(0, 1), cover=(0, 0.5), latest=(0, 10_000))
        for name, least, most in (("stay", 0, 10_000), ("speed", 0.005, 0.3), ("height", 0.01, 0.15)):
            low, high = getattr(self, name)
            if not least <= low <= high <= most:
                raise ValueError(f"hand.{name}: expected two numbers within {least} ... {most}, got {(low, high)}.")

    def bodies(self) -> str:
        """Return MJCF of the hand, invisible."""
        return prop_body(_HAND, _GEOMS, _GROUP)

    def apply(self, rng: np.random.Generator, scene: Scene) -> tuple[dict[str, Any], HandVisit | None]:
        """Draw whether, when and how the hand comes; return the drawn values, and its visit if it comes."""
        geoms = _geoms(scene)
        hide(scene.model, geoms)
        # Draw everything in any case: with another probability, episodes that have a hand have the same hand.
        comes = rng.random() < self.probability
        skin, sleeve = _draw_colours(rng, scene.hue)
        gap = _set_random_form(rng, scene.model) + rng.uniform(*self.height)
        edge = int(rng.integers(4))
        visit = HandVisit(
            scene,
            self.cover,
            self.spare,
            start=int(rng.integers(0, self.latest + 1)),
            stay=int(rng.integers(self.stay[0], self.stay[1] + 1)),
            moving=max(2, round(_FAR / rng.uniform(*self.speed))),
            heading=edge * np.pi / 2 + rng.uniform(-0.45, 0.45),
            gap=float(gap),
            aim=float(rng.random()),
            beyond=rng.uniform(-0.01, 0.06),
            colours=(skin, sleeve),
        )
        if not comes:
            return {"comes": False}, None
        plan = {"start": visit.start, "end": visit.end, "heading": visit.heading, "gap": visit.gap}
        return {"comes": True, **plan, "colours": [list(skin), list(sleeve)]}, visit


class HandVisit:
    """One visit of the hand.

    Args:
        scene: The scene.
        cover: Largest fraction of the object's points that the hand covers.
        spare: Whether it avoids the object's landmarks.
        start: Step in which it starts.
        stay: Number of steps that it stays.
        moving: Number of steps that it takes to come, and to leave.
        heading: Direction of its motion in radians, base frame.
        gap: Distance in metres of its plane from the object's nearest point, along the line of sight to its target.
        aim: The object's point that it reaches for, 0 ... 1.
        beyond: Distance by which its finger tips reach beyond that point in metres.
        colours: Colours of skin and sleeve.
    """

    def __init__(self, scene: Scene, cover: float, spare: bool, *, start: int, stay: int, moving: int, heading: float,
                 gap: float, aim: float, beyond: float, colours: tuple[Any, Any]) -> None:  # fmt: skip
        self._scene, self._cover, self._spare = scene, cover, spare
        self.start, self.heading, self.gap = start, heading, gap
        self.end = start + 2 * moving + stay
        self._moving, self._aim, self._beyond, self._colours = moving, aim, beyond, colours
        self._way = np.array([np.cos(heading), np.sin(heading), 0.0])
        self._target: Array | None = None
        self._step = 0

    def advance(self) -> None:
        """Move the hand to its place in the next step."""
        self._step += 1
        geoms = _geoms(self._scene)
        if not self.start < self._step <= self.end:
            if self._target is not None:
                hide(self._scene.model, geoms)
                self._target = None
            return
        points = self._scene.points()
        aim = points[round(self._aim * (len(points) - 1))]
        sight = self._eye() - aim
        sight /= np.linalg.norm(sight)
        aim = aim + (((points - aim) @ sight).max() + self.gap) * sight
        if self._target is None:
            show(self._scene.model, geoms, self._colours[0])
            show(self._scene.model, geoms[_FOREARM], self._colours[1])
        self._target = aim if self._target is None else self._target + 0.3 * (aim - self._target)
        back = self._distance()
        self._place(back)
        while back < 2 * _FAR and self._covers_too_much(points):
            back += _BACK
            self._place(back)

    def hidden(self, points: Array) -> float:
        """Return the fraction of ``points`` ``(n, 3)`` that the hand hides from the camera, 0 ... 1."""
        data, model = self._scene.data, self._scene.model
        eye = self._eye()
        rays = points - eye
        away = np.linalg.norm(rays, axis=1)
        hit, _ = cast_rays(model, data, eye, rays / away[:, None], groups=(_GROUP,))
        return float(((hit >= 0) & (hit < away)).mean())

    def _eye(self) -> Array:
        """Return the position ``(3,)`` of the camera."""
        return self._scene.data.cam_xpos[self._scene.model.camera(CAMERA).id]

    def _covers_too_much(self, points: Array) -> bool:
        """Return whether the hand covers more than allowed of ``points`` ``(n, 3)`` or of the landmarks."""
        return (self._spare and self.hidden(self._scene.body.landmarks()) > 0) or self.hidden(points) > self._cover

    def _distance(self) -> float:
        """Return the distance of the hand to its target in metres: it comes, stays, and leaves."""
        since, until = self._step - self.start, self.end - self._step
        part = float(np.clip(min(since, until) / self._moving, 0.0, 1.0))
        return _FAR * (1 - part**2 * (3 - 2 * part))

    def _place(self, back: float) -> None:
        """Place the hand at this distance in metres from its target."""
        assert self._target is not None
        data, mocap = self._scene.data, int(self._scene.model.body(_HAND).mocapid[0])
        data.mocap_pos[mocap] = self._target + (self._beyond - back) * self._way
        data.mocap_quat[mocap] = np.cos(self.heading / 2), 0.0, 0.0, np.sin(self.heading / 2)
        self._scene.body.refresh()


def _geoms(scene: Scene) -> NDArray[np.int64]:
    """Return the hand's geoms in the scene's model."""
    return int(scene.model.body(_HAND).geomadr[0]) + np.arange(_GEOMS)


def _draw_colours(rng: np.random.Generator, hue: float) -> tuple[Any, Any]:
    """Draw colours ``(3,)`` of hand and sleeve, neither near ``hue``."""
    skins = [skin for skin in _SKINS if skin.saturation <= GREY or hue_distance(skin.hue, hue) >= FAMILY]
    skin = choose(rng, skins)
    skin = skin._replace(value=float(np.clip(skin.value * rng.uniform(0.85, 1.1), 0.1, 1.0)))
    sleeve = Colour((hue + rng.uniform(FAMILY, 180 - FAMILY)) % 180, rng.uniform(0.0, 0.7), rng.uniform(0.15, 0.9))
    return skin.rgb, (sleeve.rgb if rng.random() < 0.5 else skin.rgb)


def _set_random_form(rng: np.random.Generator, model: Any) -> float:
    """Draw and set the form of the hand: x is forward, the tip of an open hand's middle finger near the origin.

    Returns:
        Distance of its lowest point below the hand's plane in metres.
    """
    first, scale = int(model.body(_HAND).geomadr[0]), rng.uniform(0.85, 1.1)
    side = choose(rng, (-1.0, 1.0))
    palm = [0.052 * scale, 0.043 * scale, 0.016 * scale]
    set_form(model, first + _PALM, "ellipsoid", palm, pos=(-0.11 * scale, 0.0, 0.0))
    _set_capsule(model, first + _FOREARM, scale * np.array([-0.16, 0, 0]), np.array([-0.8, 0, 0.05]), 0.032 * scale)
    spread, bend = rng.uniform(0.3, 1.6), rng.uniform(0.05, 0.7) + rng.uniform(0, 0.5, 5)
    lowest = 0.016 * scale
    for i, (root, length, heading) in enumerate(zip(_ROOTS, _LENGTHS, _SPREAD, strict=True)):
        heading = (heading if i == 0 else heading * spread) * side
        start, radius = scale * np.array([root[0], side * root[1], 0.0]), scale * (0.0105 if i == 0 else 0.009)
        for part, (share, pitch) in enumerate(((0.55, 0.4 * bend[i]), (0.45, 1.3 * bend[i]))):
            way = np.array([np.cos(heading) * np.cos(pitch), np.sin(heading) * np.cos(pitch), -np.sin(pitch)])
            end = start + scale * length * share * way
            _set_capsule(model, first + _FINGERS + 2 * i + part, start, end, radius)
            start = end
        lowest = max(lowest, radius - start[2])
    return float(lowest)


def _set_capsule(model: Any, geom: int, start: Array, end: Array, radius: float) -> None:
    """Make a geom a capsule from ``start`` to ``end`` ``(3,)`` in metres."""
    way, quaternion = end - start, np.empty(4)
    mujoco.mju_quatZ2Vec(quaternion, way)
    set_form(model, geom, "capsule", [radius, float(np.linalg.norm(way)) / 2], (start + end) / 2, quaternion)
