"""The feature ``pca``: coefficients of the principal components of recorded shapes."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from shape_obs.features.coordinates import CoordinateFrame, Coordinates, Positional
from shape_obs.features.distribution import PointDistribution, read_bytes
from shape_obs.features.feature import FeatureContext
from shape_obs.geometry.topology import Topology
from shape_obs.shape import Shape
from shape_obs.spec import SpecError

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class PrincipalComponents(Positional, kind="pca"):
    """Coefficients of the principal components of recorded shapes, which ``shape-obs fit-features`` fits.

    The values are (c_1, ..., c_K) in the unit of the points, with ``p = mean + sum_k c_k v_k``. For a file that was
    fitted with ``--align`` they are (t, s cos a, s sin a, s c_1, ..., s c_K) with ``p = t + s R(a) (mean + sum_k c_k
    v_k)``, without the shift t if the origin is the centroid. Points that were not measured have a small weight. For
    formulas and sources see ``PointDistribution``.

    Args:
        file: The fitted file, absolute or relative to the working directory. It is read once, in the constructor.
        frame: None, or the frame of the file.
        origin: None, or the origin of the file.
        max_depth: Depth in metres up to which the camera's view is taken into account for bounds.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file contains something else, is damaged, or was fitted in another frame or to another origin.
    """

    file: str
    frame: CoordinateFrame | None = None
    origin: str | None = None
    max_depth: float = 2.0

    def __post_init__(self) -> None:
        if isinstance(self.file, os.PathLike):
            object.__setattr__(self, "file", os.fspath(self.file))
        super().__post_init__()
        model, digest = read_fitted(Path(self.file))
        for name in ("frame", "origin"):
            given, fitted = getattr(self, name), getattr(model, name)
            if given not in (None, fitted):
                raise SpecError(
                    f"pca: {self.file} was fitted with {name} {fitted!r}, but {name}={given!r} was requested: "
                    f"leave {name} out, or fit again with --{name} {given}."
                )
        coordinates = Coordinates(model.frame, model.origin, self.max_depth, self.kind)
        for name, value in (("_model", model), ("_sha256", digest), ("coordinates", coordinates)):
            object.__setattr__(self, name, value)

    @property
    def model(self) -> PointDistribution:
        """The content of the file."""
        return self._model  # type: ignore[attr-defined]

    @property
    def unit(self) -> str:
        """The unit of the points; empty if the file was fitted with ``--align``, since a rotation has none."""
        return "" if self.model.aligned else self.coordinates.unit

    def units(self, layout: Topology, context: FeatureContext) -> tuple[str, ...]:
        """Return the unit of the points for each value, and none for a rotation."""
        model, unit = self._fitted_to(layout), self.coordinates.unit
        shift = max(model.placed - 2, 0) * (unit,)
        return (*shift, *(model.aligned * ("", "")), *(len(model.components) * (unit,)))

    def bounds(self, layout: Topology, context: FeatureContext) -> tuple[Array, Array]:
        """Return the bounds for points anywhere in their box; each coefficient is a weighted sum of the points.

        Raises:
            ValueError: The file was fitted to another layout.
        """
        model = self._fitted_to(layout)
        low, high = self.coordinates.box(context)
        if model.aligned:
            return self._bounds_aligned(low, high)
        up, down = np.maximum(model.components, 0.0), np.minimum(model.components, 0.0)
        at = np.tensordot(model.components, model.mean, axes=2)
        return (up @ low + down @ high).sum(axis=1) - at, (up @ high + down @ low).sum(axis=1) - at

    def compute(self, shape: Shape, context: FeatureContext) -> Array:
        """Return the values, of shape ``(K,)``; more if the file was fitted with ``--align``."""
        model = self._fitted_to(shape.layout)
        points = self.coordinates.points(shape, context)
        return model.values(points, self.coordinates.weights(shape, points))

    def reconstruct(self, values: npt.ArrayLike, layout: Topology, context: FeatureContext) -> Array:
        """Return the points with these components, of shape ``(N, 2)`` or ``(N, 3)``."""
        return self._fitted_to(layout).points(values)

    def error(self, shape: Shape, context: FeatureContext) -> float:
        """Return the mean distance of the measured points from the reconstructed ones, in the points' unit.

        If the origin is the centroid, both sets of points are taken relative to their own centroid.
        """
        points = self.coordinates.points(shape, context)
        known = self.coordinates.weights(shape, points) == 1
        off = (points - self.reconstruct(self.compute(shape, context), shape.layout, context))[known]
        if self.coordinates.origin == "centroid":
            off = off - off.mean(axis=0)
        return float(np.linalg.norm(off, axis=1).mean())

    def identity(self) -> dict[str, Any]:
        """Return what determines the values: the content of the file, not its path."""
        return {"kind": self.kind, "sha256": self._sha256, "max_depth": self.max_depth}  # type: ignore[attr-defined]

    def _fitted_to(self, layout: Topology) -> PointDistribution:
        model = self.model
        if layout != model.layout:
            raise ValueError(f"pca: {self.file} was fitted to shapes of {model.layout}, but this one is {layout}.")
        return model

    def _bounds_aligned(self, low: Array, high: Array) -> tuple[Array, Array]:
        """Return the bounds for any heading: N points of a box lie within sqrt(N) / 2 diagonals of their centroid."""
        model = self.model
        span = (high - low) / (1 if model.origin is None else 2)  # relative to an origin the box is twice as wide
        plane, rest = np.sqrt(len(model.mean)) / 2 * np.array([np.linalg.norm(span[:2]), np.linalg.norm(span[2:])])
        turn = plane / np.linalg.norm(model.mean[:, :2])
        flat, deep = (np.linalg.norm(part, axis=(1, 2)) for part in np.split(model.components, [2], axis=2))
        tilt = np.abs(np.tensordot(model.components[..., 2:], model.mean[:, 2:], axes=2))
        reach = np.concatenate([[turn, turn], plane * flat + rest * deep + turn * tilt])
        shift = slice(max(model.placed - 2, 0))  # all of its coordinates, or none
        return np.concatenate([low[shift], -reach]), np.concatenate([high[shift], reach])


def read_fitted(path: Path) -> tuple[PointDistribution, str]:
    """Return the content of a fitted file and its SHA-256; an unchanged file is parsed once.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file contains something else, or is damaged.
    """
    content = read_bytes(path)
    return _parsed(content, str(path)), hashlib.sha256(content).hexdigest()


@lru_cache(maxsize=16)
def _parsed(content: bytes, name: str) -> PointDistribution:
    return PointDistribution.from_bytes(content, name)
