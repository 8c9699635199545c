"""What a feature is given and what it promises."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraModel
from shape_obs.shape import Shape
from shape_obs.spec import Spec

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class View:
    """What surrounds a shape when a feature is computed.

    Args:
        width: Image width, pixels.
        height: Image height, pixels.
        camera: The camera model; None when only pixels are wanted.
        workspace: (low, high) corners, metres, base frame; None for what the camera can see.
        max_age: Seconds at which ``age`` saturates.
        anchor: (3,) metres, base frame: where point 0 is held; None when unknown.
    """

    width: int
    height: int
    camera: CameraModel | None = None
    workspace: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    max_age: float = 0.5
    anchor: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Feature(Spec, family="feature"):
    """A fixed number of values computed from one shape."""

    needs_depth: ClassVar[bool] = False

    @abstractmethod
    def bounds(self, count: int, view: View) -> tuple[Array, Array]:
        """Finite lowest and highest values for a shape of ``count`` points: (D,) each. Never taken from data.

        Raises:
            ValueError: The view lacks what the feature needs; the message says what.
        """

    @abstractmethod
    def compute(self, shape: Shape, view: View) -> Array:
        """(D,) values; NaN where the shape does not tell."""


def read_features(
    value: Iterable[Feature | Mapping[str, Any] | str] | Feature | Mapping[str, Any] | str,
) -> list[Feature]:
    """Features from specs, mappings or names; a single one stands for a list of it."""
    alone = isinstance(value, (Feature, Mapping, str)) or not isinstance(value, Iterable)
    return [Feature.from_dict(item) for item in ([value] if alone else value)]  # type: ignore[list-item]
