"""What a feature is given and what it promises.

The feature vector: blocks of features, shape after shape, finite and within bounds.
"""

from __future__ import annotations

import warnings
from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraModel
from shape_obs.configurations import Configuration
from shape_obs.geometry.topology import Topology
from shape_obs.shape import Shape
from shape_obs.spec import Spec

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class FeatureContext:
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
    def bounds(self, layout: Topology, context: FeatureContext) -> tuple[Array, Array]:
        """Finite lowest and highest values for a shape of this layout: (D,) each. Never taken from data.

        Raises:
            ValueError: The context lacks what the feature needs, or the feature is not defined for this layout.
        """

    @abstractmethod
    def compute(self, shape: Shape, context: FeatureContext) -> Array:
        """(D,) values; NaN where the shape does not tell."""

    def measured(self, shape: Shape, size: int) -> npt.NDArray[np.bool_]:
        """(D,) which of its D = ``size`` values were measured; all of a feature that weighs the points itself."""
        return np.ones(size, bool)

    def units(self, layout: Topology, context: FeatureContext) -> tuple[str, ...]:
        """The unit of each of the D values."""
        return len(self.bounds(layout, context)[0]) * (self.unit,)

    def reconstruct(self, values: npt.ArrayLike, layout: Topology, context: FeatureContext) -> Array:
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


class Block(NamedTuple):
    """The place of one feature of one shape in the vector.

    Args:
        shape: The shape's name.
        feature: Which one.
        place: From where to where.
        units: Of each value.
    """

    shape: str
    feature: Feature
    place: slice
    units: tuple[str, ...]


class FeatureVector:
    """Computes and bounds the concatenation of features of shapes.

    Args:
        features: In the order of the vector, for each shape.
        shapes: The configurations, in the order of the vector.
        context: What the bounds are made from; later contexts may have another camera pose, the bounds stay.

    Attributes:
        low: (D,) float32 lowest values.
        high: (D,) float32 highest values.
        blocks: What stands where.
    """

    def __init__(self, features: Sequence[Feature], shapes: Sequence[Configuration], context: FeatureContext) -> None:
        self.features = tuple(features)
        pairs = [(shape, feature) for shape in shapes for feature in self.features]
        bounds = [feature.bounds(shape.layout, context) for shape, feature in pairs]
        ends = np.cumsum([len(low) for low, _ in bounds]).tolist()
        self.blocks = tuple(
            Block(shape.name, feature, slice(end - len(low), end), feature.units(shape.layout, context))
            for (shape, feature), (low, _), end in zip(pairs, bounds, ends, strict=True)
        )
        self.low = np.concatenate([low for low, _ in bounds]).astype(np.float32)
        self.high = np.concatenate([high for _, high in bounds]).astype(np.float32)
        if not np.all(self.low < self.high) or not np.all(np.isfinite([self.low, self.high])):
            raise ValueError(f"features: bounds must be finite and low < high, got {self.low} and {self.high}.")
        self._centre = self.low + (self.high - self.low) / 2
        # Noise may leave the bounds; an object that does not fit into them is a mistake.
        self._told_from, self._told = 0.02 * (self.high - self.low), False

    def compute(self, shapes: Sequence[Shape], contexts: Sequence[FeatureContext]) -> npt.NDArray[np.float32]:
        """(D,) float32: unknown values sit at the centre of their bounds, the others are clipped to them.

        Warns once when values lie far outside of their bounds.
        """
        computed = [
            feature.compute(shape, context)
            for shape, context in zip(shapes, contexts, strict=True)
            for feature in self.features
        ]
        values = np.concatenate(computed).astype(np.float32)
        known = np.isfinite(values)
        if not known.all():
            values = np.where(known, values, self._centre)
        clipped = np.minimum(np.maximum(values, self.low), self.high)
        if not self._told and np.any(np.abs(clipped - values) > self._told_from):
            self._told = True
            warnings.warn(
                f"features: {np.count_nonzero(clipped != values)} of {len(values)} values lie outside of their bounds "
                "and are clipped to them. For points in metres give workspace=, or max_depth= of the feature, as large "
                "as the scene is. This is said once.",
                stacklevel=2,
            )
        return clipped

    def measured(self, shapes: Sequence[Shape]) -> npt.NDArray[np.bool_]:
        """(D,) which values were measured in this frame, not filled in."""
        known = {shape.name: shape for shape in shapes}
        parts = [block.feature.measured(known[block.shape], len(block.units)) for block in self.blocks]
        return np.concatenate(parts)
