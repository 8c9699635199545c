"""Domain randomisation: light, appearance, camera, material, distractors and a hand, drawn from the env's seed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Final

import numpy as np

from shape_obs.spec import Spec, SpecError, did_you_mean
from shape_obs_envs.mujoco.randomization.appearance import ObjectAppearance, TableAppearance, widened_rule
from shape_obs_envs.mujoco.randomization.distractors import DistractorRopes, Distractors
from shape_obs_envs.mujoco.randomization.factors import CameraPose, Factor, Light, Material, Scene
from shape_obs_envs.mujoco.randomization.hand_occluder import Hand, HandVisit

__all__ = ["Randomization", "Randomizer"]

#: OpenGL draws round geoms as prisms; with few sides, the corners of a palm or forearm would be visible.
_FINER: Final = '<visual><quality numslices="16" numstacks="8"/></visual>'


@dataclass(frozen=True)
class Randomization(Spec):
    """Factors that are drawn at each reset; None leaves a factor unchanged.

    Attributes:
        light: Direction, level and colour of the light.
        table: Colour, pattern and shading of the table.
        object: Colour and tones of the object, near its own hue.
        camera: Pose of the camera.
        material: Thickness, stiffness, damping and friction of the object.
        distractors: Objects on the table.
        hand: A hand that comes into view.
    """

    light: Light | None = None
    table: TableAppearance | None = None
    object: ObjectAppearance | None = None
    camera: CameraPose | None = None
    material: Material | None = None
    distractors: Distractors | None = None
    hand: Hand | None = None

    @classmethod
    def of(cls, argument: bool | Mapping[str, Any]) -> Randomization:
        """Read the environments' argument ``randomize``.

        Args:
            argument: False for no factor, True for all factors. A mapping sets each factor that it names to on (True),
                off (False) or on with other values (a mapping of its fields); factors that it does not name are on
                unless ``"others": False`` is given.

        Raises:
            ValueError: The argument has another type, an unknown name, or a value out of its range.
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
        """Whether any factor is on."""
        return any(getattr(self, name) is not None for name in FACTORS)


#: Names and specs of the factors, in the order in which they are drawn.
FACTORS: dict[str, type[Factor]] = {
    "light": Light,
    "table": TableAppearance,
    "object": ObjectAppearance,
    "camera": CameraPose,
    "material": Material,
    "distractors": Distractors,
    "hand": Hand,
}
assert list(FACTORS) == [field.name for field in fields(Randomization)]


class Randomizer:
    """Draw the factors of a ``Randomization`` for one environment; without factors it changes nothing.

    Each factor has its own random stream from the environment's seed: switching one off leaves the others unchanged.

    Args:
        argument: See ``Randomization.of``.

    Attributes:
        spec: The factors and their strength.
        drawn: The last values by factor; plain values.
    """

    spec: Randomization
    drawn: dict[str, Any]

    def __init__(self, argument: bool | Mapping[str, Any]) -> None:
        self.spec = Randomization.of(argument)
        self.drawn = {}
        self._scene: Scene | None = None
        self._streams: dict[str, np.random.Generator] = {}
        self._visit: HandVisit | None = None
        self._ropes: DistractorRopes | None = None

    # ---- when the model is written

    def bodies(self) -> str:
        """Return MJCF of the additional bodies, invisible at first."""
        return "".join(part.bodies() for part in (self.spec.distractors, self.spec.hand) if part is not None)

    def sections(self) -> str:
        """Return MJCF of additional top-level sections."""
        return (self.spec.table.sections() if self.spec.table else "") + (_FINER if self.spec.hand else "")

    def segmentation(self, rule: dict[str, Any]) -> dict[str, Any]:
        """Return the HSV rule for the object, widened if its colour or the light varies."""
        return widened_rule(rule) if self.spec.object or self.spec.light else rule

    def bind(self, scene: Scene) -> None:
        """Set the scene to change."""
        self._scene = scene
        ropes = self.spec.distractors.ropes if self.spec.distractors else 0
        if ropes and DistractorRopes.suit(scene):
            self._ropes = DistractorRopes(scene, ropes)

    # ---- at a reset

    def draw_physics(self, rng: np.random.Generator) -> None:
        """Draw what affects the physics, before the start and the goal are drawn; ``draw_appearance`` must follow.

        Args:
            rng: The environment's random generator.
        """
        self.drawn = {}
        if not self.spec.any:
            return
        seeds = rng.integers(2**63, size=len(FACTORS))
        self._streams = {name: np.random.default_rng(int(seed)) for name, seed in zip(FACTORS, seeds, strict=True)}
        self._apply("material")

    def draw_appearance(self) -> bool:
        """Draw what affects only the images, after the start; return whether anything may have changed."""
        if not self.spec.any:
            return False
        for name in ("light", "table", "object", "camera", "distractors"):
            self._apply(name)
        if self._ropes is not None:
            self.drawn["distractors"]["ropes"] = self._ropes.draw(self._streams["distractors"])
        self._visit = None
        if self.spec.hand is not None and self._scene is not None:
            self.drawn["hand"], self._visit = self.spec.hand.apply(self._streams["hand"], self._scene)
        assert self._scene is not None
        self._scene.body.refresh()
        return True

    # ---- at a step

    def advance(self) -> None:
        """Lay distractor ropes over the object and advance the hand by one step, after the physics."""
        if self._ropes is not None:
            self._ropes.advance()
        if self._visit is not None:
            self._visit.advance()

    def _apply(self, name: str) -> None:
        factor: Any = getattr(self.spec, name)
        if factor is not None:
            self.drawn[name] = factor.apply(self._streams[name], self._scene)
