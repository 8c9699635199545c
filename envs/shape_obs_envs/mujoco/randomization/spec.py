"""What is randomised and how strongly: the environments' argument `randomize`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from shape_obs.spec import Spec, SpecError, did_you_mean
from shape_obs_envs.mujoco.randomization.distractors import Distractors
from shape_obs_envs.mujoco.randomization.factor import Factor
from shape_obs_envs.mujoco.randomization.light import Light
from shape_obs_envs.mujoco.randomization.material import Material
from shape_obs_envs.mujoco.randomization.paint import Paint
from shape_obs_envs.mujoco.randomization.pose import Pose
from shape_obs_envs.mujoco.randomization.table import Table
from shape_obs_envs.mujoco.randomization.visit import Hand


@dataclass(frozen=True)
class Randomization(Spec):
    """The factors that are drawn anew at each reset; None leaves one as it is.

    Attributes:
        light: Direction, level and colour of the light.
        table: Colour, pattern and shading of the table.
        object: Colour and tones of the object, within the family of its hue.
        camera: Pose of the camera.
        material: Thickness, stiffness, damping and friction of the object.
        distractors: Things that lie about.
        hand: A hand that comes into view.
    """

    light: Light | None = None
    table: Table | None = None
    object: Paint | None = None
    camera: Pose | None = None
    material: Material | None = None
    distractors: Distractors | None = None
    hand: Hand | None = None

    @classmethod
    def of(cls, argument: bool | Mapping[str, Any]) -> Randomization:
        """Read the argument `randomize`.

        Args:
            argument: False: nothing. True: every factor. A mapping: each factor that it names is on (True), off
                (False) or on with other numbers (a mapping of its fields); those that it does not name are on unless
                it says ``"others": False``.

        Raises:
            ValueError: Something else, an unknown name, or a number out of its range.
        """
        if not isinstance(argument, (bool, Mapping)):
            raise ValueError(
                f"randomize: expected True, False or a mapping of {', '.join(FACTORS)} and 'others', got {argument!r}."
            )
        given = dict(argument) if isinstance(argument, Mapping) else {"others": argument}
        others = given.pop("others", True)
        chosen: dict[str, Any] = {}
        try:
            if not isinstance(others, bool):
                raise SpecError(f"others: expected True or False, got {others!r}.")
            for name in given:
                if name not in FACTORS:
                    raise SpecError(f"unknown factor {name!r}{did_you_mean(name, (*FACTORS, 'others'))}")
            for name, kind in FACTORS.items():
                value = given.get(name, others)
                if isinstance(value, (bool, type(None))):
                    chosen[name] = kind() if value else None
                elif isinstance(value, Mapping):
                    chosen[name] = kind.from_dict(value)
                else:
                    raise SpecError(f"{name}: expected True, False or a mapping of its fields, got {value!r}.")
            return cls(**chosen)
        except ValueError as error:
            raise ValueError(f"randomize: {error}") from error

    @property
    def any(self) -> bool:
        """Whether there is anything to draw."""
        return any(getattr(self, name) is not None for name in FACTORS)


#: Names and specs of the factors, in the order in which they are drawn.
FACTORS: dict[str, type[Factor]] = {
    "light": Light,
    "table": Table,
    "object": Paint,
    "camera": Pose,
    "material": Material,
    "distractors": Distractors,
    "hand": Hand,
}
assert list(FACTORS) == [field.name for field in fields(Randomization)]
