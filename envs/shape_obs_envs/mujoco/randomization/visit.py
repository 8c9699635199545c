"""A hand's visit: it comes over the table from an edge of the image, hides a part of the object, and leaves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.randomization.factor import Factor, Scene
from shape_obs_envs.mujoco.randomization.hand import GEOMS, HAND, HAND_GROUP, draw_colours, form_hand, hand_body
from shape_obs_envs.mujoco.randomization.props import colour, hide
from shape_obs_envs.mujoco.rays import cast_rays
from shape_obs_envs.mujoco.scene import CAMERA

Array = NDArray[np.float64]
_FAR: Final = 0.55  # from where it waits, out of view, to where it goes [m]
_BACK: Final = 0.015  # by which it draws back where it would hide too much [m]
_SLEEVE: Final = 1  # which of its geoms has the sleeve's colour


@dataclass(frozen=True)
class Hand(Factor):
    """How a hand comes into view, in the colour of skin or of a glove. It goes after a point of the object.

    Attributes:
        probability: That it comes in an episode.
        cover: Largest part of the object's points that it hides, 0 ... 1; it draws back where it would hide more.
        spare: Whether it spares what an object is known by: the ends of a rope, the corners of a cloth, and of a band
            enough of its width to be seen closed. See docs/domain-randomization.md.
        latest: Last step in which it may set out.
        stay: Least and largest number of steps for which it stays.
        speed: Least and largest distance that it covers in a step [m].
        height: Least and largest gap between it and the highest that the object gets [m].
    """

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
        """MJCF of the hand, unseen."""
        return hand_body()

    def apply(self, rng: np.random.Generator, scene: Scene) -> tuple[dict[str, Any], Visit | None]:
        """Draw whether, when and how it comes; what is drawn, and the visit where there is one."""
        geoms = _geoms(scene)
        hide(scene.model, geoms)
        # drawn all the same: with another probability other episodes have a hand, and those that have it the same one
        comes = rng.random() < self.probability
        skin, sleeve = draw_colours(rng, scene.hue)
        height = scene.reach[1][2] + form_hand(rng, scene.model) + rng.uniform(*self.height)
        edge = int(rng.integers(4))
        visit = Visit(
            scene,
            self.cover,
            self.spare,
            start=int(rng.integers(0, self.latest + 1)),
            stay=int(rng.integers(self.stay[0], self.stay[1] + 1)),
            moving=max(2, round(_FAR / rng.uniform(*self.speed))),
            heading=edge * np.pi / 2 + rng.uniform(-0.45, 0.45),
            height=float(height),
            aim=float(rng.random()),
            beyond=rng.uniform(-0.01, 0.06),
            colours=(skin, sleeve),
        )
        if not comes:
            return {"comes": False}, None
        plan = {"start": visit.start, "end": visit.end, "heading": visit.heading, "height": visit.height}
        return {"comes": True, **plan, "colours": [list(skin), list(sleeve)]}, visit


class Visit:
    """One visit of the hand.

    Args:
        scene: Where it comes.
        cover: Largest part of the object's points that it hides.
        spare: Whether it spares the object's landmarks.
        start: The step in which it sets out.
        stay: For how many steps it stays.
        moving: How many steps it takes to come, and to go.
        heading: Its way over the table [rad], base frame.
        height: Of its plane above the table [m].
        aim: Which of the object's points it goes after, 0 ... 1.
        beyond: How far its finger tips reach beyond that point [m].
        colours: Of its skin and of its sleeve.
    """

    def __init__(self, scene: Scene, cover: float, spare: bool, *, start: int, stay: int, moving: int, heading: float,
                 height: float, aim: float, beyond: float, colours: tuple[Any, Any]) -> None:  # fmt: skip
        self._scene, self._cover, self._spare = scene, cover, spare
        self.start, self.heading, self.height = start, heading, height
        self.end = start + 2 * moving + stay
        self._moving, self._aim, self._beyond, self._colours = moving, aim, beyond, colours
        self._way = np.array([np.cos(heading), np.sin(heading)])
        self._goal: Array | None = None
        self._step = 0

    def advance(self) -> None:
        """Move the hand to where it is in the next step."""
        self._step += 1
        geoms = _geoms(self._scene)
        if not self.start < self._step <= self.end:
            if self._goal is not None:
                hide(self._scene.model, geoms)
                self._goal = None
            return
        points = self._scene.points()
        aim = points[round(self._aim * (len(points) - 1)), :2]
        if self._goal is None:
            colour(self._scene.model, geoms, self._colours[0])
            colour(self._scene.model, geoms[_SLEEVE], self._colours[1])
        self._goal = aim.copy() if self._goal is None else self._goal + 0.3 * (aim - self._goal)
        back = self._distance()
        self._put(back)
        while back < 2 * _FAR and self._too_much(points):
            back += _BACK
            self._put(back)

    def hidden(self, points: Array) -> float:
        """The part of `points` (n, 3) [m] that the hand hides from the camera, 0 ... 1."""
        data, model = self._scene.data, self._scene.model
        eye = data.cam_xpos[model.camera(CAMERA).id]
        rays = points - eye
        away = np.linalg.norm(rays, axis=1)
        hit, _ = cast_rays(model, data, eye, rays / away[:, None], groups=(HAND_GROUP,))
        return float(((hit >= 0) & (hit < away)).mean())

    def _too_much(self, points: Array) -> bool:
        """Whether it hides more than it is to, of `points` (n, 3) [m] or of the landmarks."""
        return (self._spare and self.hidden(self._scene.body.landmarks()) > 0) or self.hidden(points) > self._cover

    def _distance(self) -> float:
        """How far the hand is from where it goes [m]: it comes, stays, and goes."""
        since, until = self._step - self.start, self.end - self._step
        part = float(np.clip(min(since, until) / self._moving, 0.0, 1.0))
        return _FAR * (1 - part**2 * (3 - 2 * part))

    def _put(self, back: float) -> None:
        """Put the hand so far before its goal [m]."""
        assert self._goal is not None
        data, mocap = self._scene.data, int(self._scene.model.body(HAND).mocapid[0])
        data.mocap_pos[mocap] = [*(self._goal + (self._beyond - back) * self._way), self.height]
        data.mocap_quat[mocap] = np.cos(self.heading / 2), 0.0, 0.0, np.sin(self.heading / 2)
        self._scene.body.refresh()


def _geoms(scene: Scene) -> NDArray[np.int64]:
    """The hand's geoms in the scene's model."""
    return int(scene.model.body(HAND).geomadr[0]) + np.arange(GEOMS)
