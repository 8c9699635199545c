"""Measure accuracy and speed against known truth: ``shape-obs bench``.

The options below are defined here so that a command can print its help without importing a measurement.
"""

from __future__ import annotations

from typing import Final, Literal

Clock = Literal["wall", "thread"]
Env = Literal["Cable", "Ring", "Cloth"]
ENVS: Final[tuple[Env, ...]] = ("Cable", "Ring", "Cloth")
Size = tuple[int, int]  # (width, height) of an image, in pixels
