"""Factors of the randomisation: their base class, the scene that they change, colours; light, material, camera pose."""

from __future__ import annotations

import colorsys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, ClassVar, Final, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from shape_obs.spec import Spec
from shape_obs_envs.mujoco.bodies import Body, MaterialFactors
from shape_obs_envs.mujoco.goals import Corner
from shape_obs_envs.mujoco.scene import CAMERA, CameraSpec, mujoco

Array = NDArray[np.float64]
T = TypeVar("T")

HUES = 180
#: Hues nearer than this to the object's are reserved for it; elsewhere they occur only as greys.
FAMILY = 30.0
#: Largest saturation of a grey: coloured light at most doubles it, and no segmentation rule takes that for a colour.
GREY = 0.12
#: Largest distance to which the camera may move back to see the whole workspace, as a multiple of its distance.
_FARTHEST: Final = 1.4
_RIM: Final = 0.01  # margin of the workspace in the image, as a fraction of half its size


class Factor(Spec):
    """Base of the specs of one factor each; values are checked on construction."""

    #: Name of the factor in the argument `randomize`.
    factor: ClassVar[str]

    def _check(self, **limits: tuple[float, float]) -> None:
        """Check that fields are within their limits, (least, most).

        Raises:
            ValueError: A field is not.
        """
        for name, (least, most) in limits.items():
            value = getattr(self, name)
            if not least <= value <= most:
                raise ValueError(f"{self.factor}.{name}: expected a number from {least:g} to {most:g}, got {value!r}.")


@dataclass(frozen=True)
class Scene:
    """What a factor may read and change.

    Attributes:
        body: The object with its compiled model and state.
        camera: Size and lens of the observation's camera.
        reach: Two corners (x, y, z) in metres of a box that always contains the object, base frame.
        points: Returns the object's present points ``(n, 3)`` in metres, base frame.
    """

    body: Body
    camera: CameraSpec
    reach: tuple[Corner, Corner]
    points: Callable[[], Array]

    @property
    def model(self) -> Any:
        """The compiled model."""
        return self.body.model

    @property
    def data(self) -> Any:
        """The state of the model."""
        return self.body.data

    @property
    def hue(self) -> float:
        """Original hue of the object, 0 ... 180."""
        return Colour.of(*self.body.colour).hue


class Colour(NamedTuple):
    """A colour: hue 0 ... 180 as in OpenCV, saturation and value 0 ... 1."""

    hue: float
    saturation: float
    value: float

    @classmethod
    def of(cls, red: float, green: float, blue: float) -> Colour:
        """Return the colour with the given red, green and blue, 0 ... 1 each."""
        hue, saturation, value = colorsys.rgb_to_hsv(red, green, blue)
        return cls(hue * HUES, saturation, value)

    @property
    def rgb(self) -> tuple[float, float, float]:
        """Red, green and blue, 0 ... 1 each."""
        return colorsys.hsv_to_rgb(self.hue % HUES / HUES, self.saturation, self.value)

    def away_from(self, hue: float) -> Colour:
        """Return this colour, or a grey if its hue is near ``hue``."""
        near = hue_distance(self.hue, hue) < FAMILY
        return self._replace(saturation=min(self.saturation, GREY)) if near else self


def hue_distance(one: float, other: float) -> float:
    """Return the distance of two hues, 0 ... 90."""
    apart = abs(one - other) % HUES
    return min(apart, HUES - apart)


def draw_other(rng: np.random.Generator, hue: float, darkest: float = 0.15, greys: float = 0.3) -> Colour:
    """Draw a colour whose hue is not near that of the object.

    Args:
        rng: Random generator.
        hue: Hue of the object.
        darkest: Smallest value.
        greys: Fraction of greys.
    """
    value = rng.uniform(darkest, 1.0)
    if rng.random() < greys:
        return Colour(rng.uniform(0, HUES), rng.uniform(0, GREY), value)
    return Colour((hue + rng.uniform(FAMILY, HUES - FAMILY)) % HUES, rng.uniform(0.15, 0.9), value)


def choose(rng: np.random.Generator, options: Sequence[T]) -> T:
    """Draw one of ``options`` with equal probabilities."""
    return options[int(rng.integers(len(options)))]


@dataclass(frozen=True)
class Light(Factor):
    """Variation of the light.

    Attributes:
        tilt: Largest angle between the lamp's rays and the vertical in radians, in any direction.
        level: Largest fraction by which the light is darker; it is never so bright that a colour saturates.
        ambient: Largest deviation of the ambient fraction of the light from 0.5.
        cast: Largest fraction by which red, green and blue each differ from white.
    """

    factor: ClassVar[str] = "light"
    tilt: float = 0.7
    level: float = 0.3
    ambient: float = 0.2
    cast: float = 0.08

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check(tilt=(0, 1.3), level=(0, 0.8), ambient=(0, 0.5), cast=(0, 0.3))

    def apply(self, rng: np.random.Generator, scene: Scene) -> dict[str, Any]:
        """Draw the light and set it."""
        # uniform over the cap of directions
        down = rng.uniform(np.cos(self.tilt), 1.0)
        turn, side = rng.uniform(-np.pi, np.pi), np.sqrt(1 - down**2)
        share = 0.5 + self.ambient * rng.uniform(-1, 1)
        around, lamp = np.array([[share], [1 - share]]) * (1 + self.cast * rng.uniform(-1, 1, (2, 3)))
        level = (1 - self.level * rng.random()) / (around + lamp).max()
        drawn = {
            "direction": [float(side * np.cos(turn)), float(side * np.sin(turn)), float(-down)],
            "ambient": (level * around).tolist(),
            "diffuse": (level * lamp).tolist(),
        }
        model = scene.model
        model.light_dir[0] = drawn["direction"]
        model.light_ambient[0], model.light_diffuse[0] = drawn["ambient"], drawn["diffuse"]
        return drawn


@dataclass(frozen=True)
class Material(Factor):
    """Variation of the material. A factor f means 1/f ... f, uniform in its logarithm; 1 means no variation.

    Attributes:
        thickness: Largest fraction by which the object is thinner or thicker; ignored for a cloth.
        stiffness: Factor of the bending stiffness.
        damping: Factor of the bending damping.
        friction: Factor of the table's effect: the viscosity of the medium, or the friction of a cloth.
        length: Largest fraction by which a hanging rope is shorter or longer; ignored for objects on the table.
    """

    factor: ClassVar[str] = "material"
    thickness: float = 0.25
    stiffness: float = 2.0
    damping: float = 2.0
    friction: float = 1.6
    length: float = 0.1

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check(thickness=(0, 0.4), stiffness=(1, 4), damping=(1, 4), friction=(1, 3), length=(0, 0.1))

    def apply(self, rng: np.random.Generator, scene: Scene) -> dict[str, Any]:
        """Draw the material and set it."""
        thickness = 1 + self.thickness * rng.uniform(-1, 1)
        others = np.array([self.stiffness, self.damping, self.friction]) ** rng.uniform(-1, 1, 3)
        factors = MaterialFactors(thickness, *others.tolist(), length=1 + self.length * rng.uniform(-1, 1))
        scene.body.set_material(factors)
        return asdict(factors)


@dataclass(frozen=True)
class CameraPose(Factor):
    """Variation of the camera's pose. The camera then moves back as far as needed to see the whole workspace.

    Attributes:
        distance: Largest fraction by which the camera is nearer or farther.
        tilt: Largest change of the angle between its axis and the vertical in radians.
        turn: Largest rotation about the vertical through its aim in radians.
        roll: Largest rotation about its own axis in radians.
        aim: Largest shift of the point that it looks at, along x and along y, in metres.
    """

    factor: ClassVar[str] = "camera"
    distance: float = 0.08
    tilt: float = 0.12
    turn: float = 0.2
    roll: float = 0.05
    aim: float = 0.025

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check(distance=(0, 0.3), tilt=(0, 0.4), turn=(0, np.pi), roll=(0, 0.5), aim=(0, 0.1))

    def apply(self, rng: np.random.Generator, scene: Scene) -> dict[str, Any]:
        """Draw the pose and set it."""
        spec, model = scene.camera, scene.model
        distance = spec.distance * (1 + self.distance * rng.uniform(-1, 1))
        tilt = spec.tilt + self.tilt * rng.uniform(-1, 1)
        turn, roll = self.turn * rng.uniform(-1, 1), self.roll * rng.uniform(-1, 1)
        aim = spec.aim + np.array([*(self.aim * rng.uniform(-1, 1, 2)), 0.0])
        axes = _rotation(2, turn) @ _rotation(0, tilt) @ _rotation(2, roll)
        half = np.array([spec.width, spec.height]) / 2 / spec.intrinsics.fx * (1 - _RIM)
        corners = np.array(np.meshgrid(*zip(*scene.reach, strict=True))).reshape(3, -1).T
        distance = min(max(distance, _least_distance(axes, corners - aim, half)), _FARTHEST * spec.distance)
        index, quaternion = model.camera(CAMERA).id, np.empty(4)
        mujoco.mju_mat2Quat(quaternion, axes.ravel())
        model.cam_pos[index], model.cam_quat[index] = aim + distance * axes[:, 2], quaternion
        scene.body.refresh()
        return {"distance": float(distance), "tilt": tilt, "turn": turn, "roll": roll, "aim": aim.tolist()}


def _least_distance(axes: Array, points: Array, half: Array) -> float:
    """Return the least distance from which a camera that looks at the origin along -z of ``axes`` sees all ``points``.

    Args:
        axes: Axes of the camera, ``(3, 3)``; columns: right, up and backwards.
        points: Points ``(n, 3)`` in metres.
        half: Tangents ``(2,)`` of half the fields of view, horizontal and vertical.
    """
    local = points @ axes
    # |x| <= half * (distance - z), and likewise y
    return float((np.abs(local[:, :2]) / half + local[:, 2:]).max())


def _rotation(axis: int, angle: float) -> Array:
    """Return the rotation ``(3, 3)`` about a coordinate axis."""
    one, two = (axis + 1) % 3, (axis + 2) % 3
    out = np.eye(3)
    out[one, one] = out[two, two] = np.cos(angle)
    out[one, two], out[two, one] = -np.sin(angle), np.sin(angle)
    return out
