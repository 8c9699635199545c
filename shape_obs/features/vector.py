"""The feature vector: blocks of features, shape after shape, finite and within bounds."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.configurations import Configuration
from shape_obs.features.base import Feature, View
from shape_obs.shape import Shape


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
        view: What the bounds are made from; later views may have another camera pose, the bounds stay.

    Attributes:
        low: (D,) float32 lowest values.
        high: (D,) float32 highest values.
        blocks: What stands where.
    """

    def __init__(self, features: Sequence[Feature], shapes: Sequence[Configuration], view: View) -> None:
        self.features = tuple(features)
        pairs = [(shape, feature) for shape in shapes for feature in self.features]
        bounds = [feature.bounds(shape.layout, view) for shape, feature in pairs]
        ends = np.cumsum([len(low) for low, _ in bounds]).tolist()
        self.blocks = tuple(
            Block(shape.name, feature, slice(end - len(low), end), feature.units(shape.layout, view))
            for (shape, feature), (low, _), end in zip(pairs, bounds, ends, strict=True)
        )
        self.low = np.concatenate([low for low, _ in bounds]).astype(np.float32)
        self.high = np.concatenate([high for _, high in bounds]).astype(np.float32)
        if not np.all(self.low < self.high) or not np.all(np.isfinite([self.low, self.high])):
            raise ValueError(f"features: bounds must be finite and low < high, got {self.low} and {self.high}.")
        self._centre = self.low + (self.high - self.low) / 2
        # Noise may leave the bounds; an object that does not fit into them is a mistake.
        self._told_from, self._told = 0.02 * (self.high - self.low), False

    def compute(self, shapes: Sequence[Shape], views: Sequence[View]) -> npt.NDArray[np.float32]:
        """(D,) float32: unknown values sit at the centre of their bounds, the others are clipped to them.

        Warns once when values lie far outside of their bounds.
        """
        computed = [
            feature.compute(shape, view) for shape, view in zip(shapes, views, strict=True) for feature in self.features
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
