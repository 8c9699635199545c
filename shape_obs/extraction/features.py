"""FeatureLog: collects features frame by frame, as columns beside those of the shapes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from shape_obs.configurations import Configuration
from shape_obs.features import Block, Feature, FeatureVector
from shape_obs.features import FeatureContext as View
from shape_obs.recording import Moment
from shape_obs.recording.table import Column
from shape_obs.shape import Detection


class FeatureLog:
    """Collects the vector that ``ShapeObservation`` would have shown.

    Args:
        features: Of each shape.
        shapes: As the detector resolved them.
        workspace: (low, high) corners, metres, base frame, that bound points in the base frame.
        max_age: Seconds at which ``age`` saturates.
    """

    def __init__(
        self, features: Sequence[Feature], shapes: Sequence[Configuration], workspace: Any, max_age: float
    ) -> None:
        self._features, self._shapes = tuple(features), tuple(shapes)
        self._workspace, self._max_age = workspace, max_age
        self._vector: FeatureVector | None = None
        self._values: list[Column] = []
        self._measured: list[Column] = []

    def add(self, moment: Moment, detection: Detection) -> None:
        """Take a frame.

        Raises:
            ValueError: A feature lacks what it needs, such as depth or the camera's place.
        """
        # Inside, since it brings gymnasium.
        from shape_obs.wrappers.env_protocol import base_point

        if not self._features:
            return
        height, width = moment.frame.size or (1, 1)
        view = View(width, height, moment.frame.camera, self._workspace, self._max_age, anchors=moment.anchors)
        if self._vector is None:
            self._vector = FeatureVector(self._features, self._shapes, view)
        views = [replace(view, anchor=base_point(shape, moment.anchors)) for shape in self._shapes]
        self._values.append(self._vector.compute(detection.shapes, views))
        self._measured.append(self._vector.measured(detection.shapes))

    def columns(self) -> dict[str, Column]:
        """``<shape>/features/<kind>`` (F,D) float32 and, beside each, ``.../measured`` (F,D) bool."""
        if self._vector is None:
            return {}
        values, measured = np.stack(self._values), np.stack(self._measured)
        columns = {}
        for name, block in _named(self._vector.blocks):
            columns[name] = values[:, block.place]
            columns[f"{name}/measured"] = measured[:, block.place]
        return columns

    def described(self) -> dict[str, Any]:
        """Column -> ``feature``, the spec as a mapping, and ``units`` of each value; JSON-able."""
        blocks = () if self._vector is None else self._vector.blocks
        return {
            name: {"feature": block.feature.to_dict(), "units": list(block.units)} for name, block in _named(blocks)
        }


def _named(blocks: Iterable[Block]) -> Iterable[tuple[str, Block]]:
    """Blocks with the names of their columns; a second one of a kind is numbered."""
    seen: Counter[str] = Counter()
    for block in blocks:
        name = f"{block.shape}/features/{block.feature.kind}"
        seen[name] += 1
        yield name if seen[name] == 1 else f"{name}_{seen[name]}", block
