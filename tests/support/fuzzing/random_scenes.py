"""Sequences of random inputs: a scene whose object moves by a few pixels or is replaced by anything."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from fuzzing import random_inputs
from fuzzing.random_inputs import pick


class Scene:
    """What several frames share: the size of the image, the camera, and an object that moves by a few pixels.

    It has what the configurations need, most of the time; else the detector refuses the frame.
    """

    def __init__(self, rng: np.random.Generator, specs: list[dict[str, Any]]) -> None:
        usual = rng.random() < 0.9
        anchors = [spec["anchor"] for spec in specs if spec["anchor"] is not None]
        self.needed = usual and any(spec["lift"] == "cloud" or spec["spacing"] == "m" for spec in specs)
        posed = usual and any(isinstance(anchor, str) or len(anchor) == 3 for anchor in anchors)
        self.size = random_inputs.image_size(rng)
        self.camera = random_inputs.camera(rng, self.size, needed=self.needed or posed, posed=posed)
        self.anchors = pick(rng, (None, {"hand": (3.0, 4.0)})) if not usual else {"hand": (0.1, 0.0, 0.5)}
        held = random_inputs.HELD[specs[0]["kind"]]
        self.cloud = random_inputs.cloud(rng, held)
        self.mask, self.depth = self._images(rng, held)

    def next_frame(self, rng: np.random.Generator) -> None:
        """Move the object, or replace it by anything."""
        if rng.random() < 0.5:
            self.mask = np.roll(self.mask, rng.integers(-2, 3, 2), axis=(0, 1))
            self.cloud = self.cloud + self.cloud.dtype.type(1e-3)
        else:
            self.mask, self.depth = self._images(rng)
            self.cloud = random_inputs.cloud(rng)

    def _images(self, rng: np.random.Generator, *kinds: tuple[str, ...]) -> tuple[Any, Any]:
        depth = random_inputs.depth(rng, self.size, needed=self.needed)
        return random_inputs.mask(rng, self.size, *kinds), depth


class RandomImages(gym.Env[Any, Any]):
    """An env without physics, whose images are those of a scene."""

    def __init__(self, rng: np.random.Generator, scene: Scene) -> None:
        self.rng, self.scene, self.camera_model = rng, scene, scene.camera
        self.anchors = scene.anchors or {}
        size = scene.size
        self.action_space = gym.spaces.Discrete(2)
        box = gym.spaces.Box
        images = {"rgb": box(0, 255, (*size, 3), np.uint8), "depth": box(-np.inf, np.inf, size, np.float32)}
        self.observation_space = gym.spaces.Dict(images)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Return new images."""
        return self._observation(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Return new images."""
        return self._observation(), 0.0, False, False, {}

    def _observation(self) -> dict[str, Any]:
        self.scene.next_frame(self.rng)
        depth = np.zeros(self.scene.size, np.float32) if self.scene.depth is None else self.scene.depth
        if depth.dtype == np.uint16:
            depth = depth * np.float32(1e-3)
        image = colour_image(self.rng, self.scene.mask)
        with np.errstate(over="ignore"):
            return {"rgb": image, "depth": depth.astype(np.float32)}


def colour_image(rng: np.random.Generator, mask: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    """Return a colour image: the mask on a dark table, or noise."""
    if rng.random() < 0.2:
        return rng.integers(0, 256, (*mask.shape, 3), dtype=np.uint8)
    return np.repeat(np.where(mask > 0, 230, 20).astype(np.uint8)[..., None], 3, axis=2)
