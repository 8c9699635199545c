"""The interface of a feature, and the vector that the features of all shapes form."""

from __future__ import annotations

import warnings
from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraModel, as_camera_model
from shape_obs.configurations.base import Configuration
from shape_obs.geometry.topology import Topology
from shape_obs.image.segmentation import DepthRange
from shape_obs.shape import Shape
from shape_obs.spec import Spec

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

#: Share of its range by which a value may exceed its bounds without a warning: noise does, a wrong workspace is larger.
_NOISE_MARGIN: Final = 0.02

Vector = npt.NDArray[Any]

_NUMBERS: Final = "fiub"  # kinds of dtype: float, whole numbers, bool


@dataclass(frozen=True)
class FeatureContext:
    """Everything besides the shape that a feature is computed from.

    Args:
        width: Image width in pixels.
        height: Image height in pixels.
        camera: The camera model, or what ``as_camera_model`` makes one of; None if only pixels are needed.
        workspace: (low, high) corners in metres, base frame; None for everything the camera can see.
        max_age: Seconds at which the feature ``age`` saturates.
        anchor: (x, y, z) in metres, base frame, where point 0 is held; None if unknown.
        anchors: All published anchors by name: (x, y, z) in metres, base frame, or (u, v) in pixels.
    """

    width: int
    height: int
    camera: CameraModel | None = None
    workspace: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    max_age: float = 0.5
    anchor: tuple[float, float, float] | None = None
    anchors: Mapping[str, Sequence[float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "camera", as_camera_model(self.camera, (self.height, self.width)))


@dataclass(frozen=True)
class Feature(Spec, family="feature"):
    """Compute a fixed number of values from one shape."""

    @property
    def unit(self) -> str:
        """The unit of the values, such as ``"m"``, ``"px"`` or ``"rad"``; empty if they have none or several."""
        return ""

    @property
    def needs_depth(self) -> bool:
        """Whether the feature is computed from ``points3d``."""
        return False

    @property
    def anchored(self) -> bool:
        """Whether the values change when only the anchors move."""
        return False

    @property
    def invertible(self) -> bool:
        """Whether ``reconstruct`` can turn the values back into points."""
        return type(self).reconstruct is not Feature.reconstruct

    @abstractmethod
    def bounds(self, layout: Topology, context: FeatureContext) -> tuple[Array, Array]:
        """Return the lowest and highest values for a shape of this layout, of shape ``(D,)`` each.

        Bounds are finite and depend on the image size or the workspace, never on data.

        Raises:
            ValueError: The context lacks what the feature needs, or the feature is not defined for this layout.
        """

    @abstractmethod
    def compute(self, shape: Shape, context: FeatureContext) -> Array:
        """Return the values, of shape ``(D,)``; NaN where the shape does not determine them."""

    def measured(self, shape: Shape, size: int) -> npt.NDArray[np.bool_]:
        """Return which of the D = ``size`` values were measured; all of them if the feature weights the points."""
        return np.ones(size, bool)

    def units(self, layout: Topology, context: FeatureContext) -> tuple[str, ...]:
        """Return the unit of each of the D values."""
        return len(self.bounds(layout, context)[0]) * (self.unit,)

    def components(self, size: int) -> tuple[str, ...]:
        """Return the names of the D = ``size`` values; an only value has an empty name."""
        return tuple(str(i) for i in range(size)) if size > 1 else ("",)

    def reconstruct(self, values: npt.ArrayLike, layout: Topology, context: FeatureContext) -> Array:
        """Return the points that the values describe, of shape (N, 2) or (N, 3), in the feature's frame and unit.

        Raises:
            ValueError: The feature does not determine the points.
        """
        raise ValueError(f"feature {self.kind!r} cannot be turned back into points.")

    def identity(self) -> dict[str, Any]:
        """Return what determines the values, as JSON values; the feature schema is the hash of it."""
        return self.to_dict()


def read_features(
    value: Iterable[Feature | Mapping[str, Any] | str] | Feature | Mapping[str, Any] | str,
) -> list[Feature]:
    """Return features from specs, mappings or names; a single one counts as a list of one."""
    alone = isinstance(value, (Feature, Mapping, str)) or not isinstance(value, Iterable)
    return [Feature.from_dict(item) for item in ([value] if alone else value)]  # type: ignore[list-item]


def what_needs_depth(shapes: Iterable[Configuration], features: Iterable[Feature]) -> list[str]:
    """Return everything in a configuration that needs depth, in words for an error message."""
    needs = [f"feature {feature.kind!r}" for feature in features if feature.needs_depth]
    for spec in shapes:
        needs += [f"lift='cloud' of shape {spec.name!r}"] if spec.lift == "cloud" else []
        needs += [f"spacing='m' of shape {spec.name!r}"] if spec.spacing == "m" else []
        needs += [f"segmentation 'depth' of shape {spec.name!r}"] if isinstance(spec.segmentation, DepthRange) else []
    return needs


class Block(NamedTuple):
    """The position of one feature of one shape in the vector.

    Args:
        shape: The name of the shape.
        feature: The feature.
        place: The slice of the vector.
        units: The unit of each value.
    """

    shape: str
    feature: Feature
    place: slice
    units: tuple[str, ...]


def _place(shape: str, feature: Feature) -> str:
    """Return what error messages call a feature of a shape."""
    return f"feature {feature.kind or type(feature).__name__!r} of shape {shape!r}"


class FeatureVector:
    """Compute the features of all shapes as one finite, bounded vector.

    Args:
        features: The features of each shape, in the order of the vector.
        shapes: The configurations of the shapes, in the order of the vector.
        context: The context that determines the bounds; later contexts may have another camera pose.

    Attributes:
        low: ``(D,)`` float32 lowest values.
        high: ``(D,)`` float32 highest values.
        blocks: The position of each feature of each shape.
        anchored: Whether any value changes when only the anchors move.

    Raises:
        TypeError: The bounds of a feature are no arrays of numbers.
        ValueError: A feature is not defined for a shape, or its bounds are empty or not finite.
    """

    low: npt.NDArray[np.float32]
    high: npt.NDArray[np.float32]
    blocks: tuple[Block, ...]
    anchored: bool

    def __init__(self, features: Sequence[Feature], shapes: Sequence[Configuration], context: FeatureContext) -> None:
        self.features = tuple(features)
        self.anchored = any(feature.anchored for feature in self.features)
        pairs = [(shape, feature) for shape in shapes for feature in self.features]
        bounds = [
            check_bounds(feature.bounds(shape.layout, context), _place(shape.name, feature)) for shape, feature in pairs
        ]
        ends = np.cumsum([len(low) for low, _ in bounds]).tolist()
        self.blocks = tuple(
            Block(shape.name, feature, slice(end - len(low), end), feature.units(shape.layout, context))
            for (shape, feature), (low, _), end in zip(pairs, bounds, ends, strict=True)
        )
        self.low = np.concatenate([low for low, _ in bounds]).astype(np.float32)
        self.high = np.concatenate([high for _, high in bounds]).astype(np.float32)
        for block in self.blocks:  # numbers that are equal or infinite in single precision
            check_bounds((self.low[block.place], self.high[block.place]), _place(block.shape, block.feature))
        self._sizes = [len(low) for low, _ in bounds]
        self._centre = self.low + (self.high - self.low) / 2
        self._margin, self._warned = _NOISE_MARGIN * (self.high - self.low), False

    def compute(self, shapes: Sequence[Shape], contexts: Sequence[FeatureContext]) -> npt.NDArray[np.float32]:
        """Return the vector, of shape ``(D,)``, float32.

        Unknown values are set to the centre of their bounds, the others are clipped to their bounds. Warns once if
        values lie far outside their bounds, or are NaN though all points of the shape are known.

        Args:
            shapes: The detected shapes, in the order of the configurations.
            contexts: The context of each shape.

        Raises:
            TypeError: A feature returned no array of numbers.
            ValueError: A feature returned another number of values than it has bounds.
        """
        computed, sizes = [], iter(self._sizes)
        for shape, context in zip(shapes, contexts, strict=True):
            for feature in self.features:
                values, size = feature.compute(shape, context), next(sizes)
                if type(values) is not np.ndarray or values.dtype.kind != "f" or values.shape != (size,):
                    check_values(values, size, _place(shape.name, feature))
                computed.append(values)
        values = np.concatenate(computed, dtype=np.float32)
        clipped = np.minimum(np.maximum(values, self.low), self.high)
        if np.count_nonzero(clipped == values) == len(values):  # all are known, and within their bounds
            return clipped
        known = np.isfinite(values)
        filled = np.where(known, values, self._centre)
        clipped = np.minimum(np.maximum(filled, self.low), self.high)
        if not self._warned:
            self._warn(shapes, values, np.abs(clipped - filled) > self._margin, ~known)
        return clipped

    def _warn(self, shapes: Sequence[Shape], values: npt.NDArray[np.float32], outside: Flags, unknown: Flags) -> None:
        """Warn once of the first values that no feature should return, and name the feature."""
        sound = {shape.name for shape in shapes if shape.ok and shape.valid.all()}
        for block in self.blocks:
            wrong = outside[block.place] | (unknown[block.place] & (block.shape in sound))
            for k in np.flatnonzero(wrong)[:1].tolist():
                self._warned, at, where = True, block.place.start + k, _place(block.shape, block.feature)
                if unknown[at]:
                    problem = (
                        f"{where}: value {k} is {values[at]:g} though all points of the shape are known, and is "
                        "replaced by the middle of its bounds."
                    )
                else:
                    problem = (
                        f"features: {np.count_nonzero(outside)} of {len(values)} values lie outside their bounds and "
                        f"are clipped, first value {k} of {where}: {values[at]:g}, bounds {self.low[at]:g} ... "
                        f"{self.high[at]:g}. For points in metres set workspace=, or max_depth= of the feature, to the "
                        "size of the scene."
                    )
                warnings.warn(f"{problem} This warning is shown once.", stacklevel=3)
                return

    def named(self, values: npt.ArrayLike) -> dict[str, dict[str, float]]:
        """Return values by feature and component: ``{"rope/points3d": {"x0": 0.1, ...}}``.

        Args:
            values: ``(D,)`` as ``compute`` returns them. Further features of a kind are numbered: ``"rope/pca_2"``.
        """
        found: dict[str, dict[str, float]] = {}
        array = np.asarray(values, np.float64)
        for block in self.blocks:
            stem = f"{block.shape}/{block.feature.kind}"
            count = sum(name.rpartition("_")[0] == stem or name == stem for name in found)
            names = block.feature.components(len(block.units))
            part = dict(zip(names, array[block.place].tolist(), strict=True))
            found[f"{stem}_{count + 1}" if count else stem] = part
        return found

    def measured(self, shapes: Sequence[Shape]) -> npt.NDArray[np.bool_]:
        """Return which values were measured in this frame and not filled in, of shape ``(D,)``."""
        known = {shape.name: shape for shape in shapes}
        parts = [block.feature.measured(known[block.shape], len(block.units)) for block in self.blocks]
        return np.concatenate(parts)


def check_bounds(bounds: Any, what: str) -> tuple[Vector, Vector]:
    """Return the bounds of a feature, lowest and highest values.

    Args:
        bounds: What ``Feature.bounds`` returned.
        what: The feature and its shape, for error messages.

    Raises:
        TypeError: They are no pair of arrays of numbers.
        ValueError: They are not of one shape ``(D,)``, not finite, or not low < high.
    """
    if not isinstance(bounds, (tuple, list)) or len(bounds) != 2:
        raise TypeError(f"{what}: bounds() must return (low, high), got {bounds!r:.100}.")
    low, high = bounds
    for name, values in (("low", low), ("high", high)):
        if not isinstance(values, np.ndarray) or values.dtype.kind not in _NUMBERS:
            raise TypeError(f"{what}: bounds() must return numpy arrays of numbers, got {name} = {_described(values)}.")
    if low.ndim != 1 or low.shape != high.shape or not low.size:
        raise ValueError(
            f"{what}: bounds() must return two arrays of one shape (D,), got {low.shape} and {high.shape}."
        )
    for k in np.flatnonzero(~(np.isfinite(low) & np.isfinite(high) & (low < high)))[:1].tolist():
        raise ValueError(f"{what}: bounds must be finite and low < high, got {low[k]:g} and {high[k]:g} for value {k}.")
    return low, high


def check_values(values: Any, size: int, what: str) -> None:
    """Refuse what ``Feature.compute`` returned unless it is an array of ``size`` numbers; they may be NaN.

    Args:
        values: The values.
        size: How many bounds the feature has.
        what: The feature and its shape, for error messages.

    Raises:
        TypeError: They are no array of numbers.
        ValueError: They have another shape than the bounds.
    """
    if not isinstance(values, np.ndarray) or values.dtype.kind not in _NUMBERS:
        raise TypeError(f"{what}: compute() must return a numpy array of numbers, got {_described(values)}.")
    if values.shape != (size,):
        raise ValueError(f"{what}: compute() must return shape ({size},), as its bounds have, got {values.shape}.")


def _described(value: Any) -> str:
    return f"an array of {value.dtype}" if isinstance(value, np.ndarray) else f"{value!r:.60} ({type(value).__name__})"
