"""The randomisation of one environment: what is added to its model, what is drawn at a reset, what moves at a step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from shape_obs_envs.mujoco.randomization.factor import Scene
from shape_obs_envs.mujoco.randomization.paint import widened
from shape_obs_envs.mujoco.randomization.spec import FACTORS, Randomization
from shape_obs_envs.mujoco.randomization.visit import Visit

#: The compiled geoms of OpenGL are prisms; a palm or a forearm of a few would show its corners.
_FINER: Final = '<visual><quality numslices="16" numstacks="8"/></visual>'


class Randomizer:
    """Draws the factors of a `Randomization`; without one it adds, draws and changes nothing.

    Each factor has a stream of its own from the environment's seed: switching one off leaves all others as they were.

    Args:
        argument: What `Randomization.of` takes.

    Attributes:
        spec: What is drawn, and how strongly.
        drawn: What was drawn last, factor by factor; plain values.
    """

    def __init__(self, argument: bool | Mapping[str, Any]) -> None:
        self.spec = Randomization.of(argument)
        self.drawn: dict[str, Any] = {}
        self._scene: Scene | None = None
        self._streams: dict[str, np.random.Generator] = {}
        self._visit: Visit | None = None

    # ---- when the model is written

    def bodies(self) -> str:
        """MJCF of the bodies that stand in the scene from the beginning, unseen."""
        return "".join(part.bodies() for part in (self.spec.distractors, self.spec.hand) if part is not None)

    def sections(self) -> str:
        """MJCF of whole sections."""
        return (self.spec.table.sections() if self.spec.table else "") + (_FINER if self.spec.hand else "")

    def segmentation(self, rule: dict[str, Any]) -> dict[str, Any]:
        """The HSV rule that fits the object: wider where its colour or the light varies."""
        return widened(rule) if self.spec.object or self.spec.light else rule

    def bind(self, scene: Scene) -> None:
        """Take the scene that is to be changed."""
        self._scene = scene

    # ---- at a reset

    def make(self, rng: np.random.Generator) -> None:
        """Draw what the physics depend on, before the start and the goal are; `dress` is to follow.

        Args:
            rng: The environment's.
        """
        self.drawn = {}
        if not self.spec.any:
            return
        seeds = rng.integers(2**63, size=len(FACTORS))
        self._streams = {name: np.random.default_rng(int(seed)) for name, seed in zip(FACTORS, seeds, strict=True)}
        self._apply("material")

    def dress(self) -> bool:
        """Draw what is only seen, when the start is there; whether anything may have changed."""
        if not self.spec.any:
            return False
        for name in ("light", "table", "object", "camera", "distractors"):
            self._apply(name)
        self._visit = None
        if self.spec.hand is not None and self._scene is not None:
            self.drawn["hand"], self._visit = self.spec.hand.apply(self._streams["hand"], self._scene)
        assert self._scene is not None
        self._scene.body.refresh()
        return True

    # ---- at a step

    def advance(self) -> None:
        """Move what moves by itself, after the physics."""
        if self._visit is not None:
            self._visit.advance()

    def _apply(self, name: str) -> None:
        factor: Any = getattr(self.spec, name)
        if factor is not None:
            self.drawn[name] = factor.apply(self._streams[name], self._scene)
