"""What a feature is given and what it promises."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraModel
from shape_obs.geometry.topology import Topology
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
        anchors: The published anchors by name: (3,) metres, base frame, or (2,) pixels.
    """

    width: int
    height: int
    camera: CameraModel | None = None
    workspace: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    max_age: float = 0.5
    anchor: tuple[float, float, float] | None = None
    anchors: Mapping[str, Sequence[float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Feature(Spec, family="feature"):
    """A fixed number of values computed from one shape."""

    @property
    def unit(self) -> str:
        """Of its values: ``"m"``, ``"px"``, ``"rad"``, ...; empty where they have none, or not all the same."""
        return ""

    @property
    def needs_depth(self) -> bool:
        """Whether it is computed from ``points3d``."""
        return False

    @property
    def anchored(self) -> bool:
        """Whether its values change when only the anchors move."""
        return False

    @property
    def invertible(self) -> bool:
        """Whether points can be had back from its values."""
        return type(self).reconstruct is not Feature.reconstruct

    @abstractmethod
    def bounds(self, layout: Topology, view: View) -> tuple[Array, Array]:
        """Finite lowest and highest values for a shape of this layout: (D,) each. Never taken from data.

        Raises:
            ValueError: The view lacks what the feature needs, or there is no such feature of this layout; the message
                says what.
        """

    @abstractmethod
    def compute(self, shape: Shape, view: View) -> Array:
        """(D,) values; NaN where the shape does not tell."""

    def measured(self, shape: Shape, size: int) -> npt.NDArray[np.bool_]:
        """(D,) which of its D = ``size`` values were measured; all of a feature that weighs the points itself."""
        return np.ones(size, bool)

    def units(self, layout: Topology, view: View) -> tuple[str, ...]:
        """The unit of each of the D values."""
        return len(self.bounds(layout, view)[0]) * (self.unit,)

    def reconstruct(self, values: npt.ArrayLike, layout: Topology, view: View) -> Array:
        """The points that the values stand for: (D,) -> (N,2) or (N,3), in the feature's own frame and unit.

        Raises:
            ValueError: The feature keeps too little of the shape for that.
        """
        raise ValueError(f"feature {self.kind!r} cannot be turned back into points.")

    def identity(self) -> dict[str, Any]:
        """What decides the values, JSON-able: what the feature schema's hash is made of."""
        return self.to_dict()


def read_features(
    value: Iterable[Feature | Mapping[str, Any] | str] | Feature | Mapping[str, Any] | str,
) -> list[Feature]:
    """Features from specs, mappings or names; a single one stands for a list of it."""
    alone = isinstance(value, (Feature, Mapping, str)) or not isinstance(value, Iterable)
    return [Feature.from_dict(item) for item in ([value] if alone else value)]  # type: ignore[list-item]
