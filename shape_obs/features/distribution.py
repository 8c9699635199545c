"""A model of recorded shapes: their alignment, their mean and principal components, and its file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Final, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from shape_obs.features.basis import Design
from shape_obs.features.coordinates import CoordinateFrame, Coordinates
from shape_obs.geometry.rotation import fit
from shape_obs.geometry.topology import Chain, Grid, Ring, Topology
from shape_obs.utils.arrays import decode_npz
from shape_obs.utils.documents import parse_json
from shape_obs.utils.files import make_folder, write_whole

Array = npt.NDArray[np.float64]

_ALIGNMENTS: Final = 200  # rounds of a superposition, at most
_CONVERGED: Final = 1e-12
_UNLIKE: Final = 0.05  # smallest scale of an aligned shape; below it the heading is arbitrary

FORMAT: Final = "shape_obs point distribution"
VERSION: Final = 1
_ARRAYS: Final = ("mean", "components", "variance", "noise")
_LAYOUTS: Final[Mapping[str, type[Any]]] = {"chain": Chain, "ring": Ring, "grid": Grid}
_FRAMES: Final = get_args(CoordinateFrame)
_MOST_BYTES: Final = 32 << 20  # largest size of all arrays of a file; 100 components of a large lattice take 3 MB
_FLAT: Final = 1e-9  # share of the first component's variance, and of the shapes' extent, below which all is rounding
_FLOOR: Final = 1e-6  # smallest noise of the points, as a share of the last component's variance
#: Residuals of neighbouring points are correlated: this many of them count as one (g in the formula).
_CORRELATED: Final = 10.0
_ROUNDS: Final = 3  # Gauss-Newton steps; for complete shapes the first is exact


class Similarity(NamedTuple):
    """Represent ``p = shift + turn * q`` with the first two coordinates as a complex number.

    The third coordinate is only shifted and scaled.

    Args:
        shift: The translation, of shape ``(2,)`` or ``(3,)``.
        turn: The scale times exp(i angle).
    """

    shift: Array
    turn: complex

    @classmethod
    def of(cls, points: Array, mean: Array, weight: Array) -> Similarity:
        """Return the transform that brings the mean shape closest to the points, by weighted least squares.

        Source: T. F. Cootes et al., "Active Shape Models: Their Training and Application", Computer Vision and Image
        Understanding 61(1), 1995, appendix A.

        Args:
            points: ``(N, D)`` points; only the first two coordinates are fitted.
            mean: ``(N, D)`` mean shape.
            weight: ``(N,)`` weights.
        """
        fitted = fit(mean[:, :2], points[:, :2], weight, scaled=True)
        turn = fitted.scale * complex(*fitted.rotation[:, 0])
        return cls((weight @ points - _turned(weight @ mean, turn)) / weight.sum(), turn)

    def apply(self, points: Array) -> Array:
        """Transform points ``(N, D)`` of the mean shape."""
        return self.shift + _turned(points, self.turn)

    def undo(self, points: Array) -> Array:
        """Apply the inverse transform to points ``(N, D)``; the result is not finite if the scale is zero."""
        return _turned(points - self.shift, 1 / self.turn if self.turn else complex(np.nan))


def superimposed(points: Array) -> Array:
    """Remove position, heading and size from shapes by generalised Procrustes analysis: ``(F, N, D)`` -> ``(F, N, D)``.

    Each shape is transformed to the mean by its best similarity, which gives the next mean. The mean has the root mean
    square size of the shapes and their mean heading. Source: J. C. Gower, "Generalized Procrustes analysis",
    Psychometrika 40(1), 1975.

    Raises:
        ValueError: A shape differs so much from the others that its heading is arbitrary.
    """
    centred = points - points.mean(axis=1, keepdims=True)
    plane = centred[..., 0] + 1j * centred[..., 1]
    size = np.sqrt(np.mean(np.sum(np.abs(plane) ** 2, axis=1)))
    mean = plane[0]
    turn = np.ones(len(plane), complex)
    for _ in range(_ALIGNMENTS):
        mean = mean * (size / np.linalg.norm(mean))
        turn = plane @ mean.conj() / size**2
        unlike = np.flatnonzero(np.abs(turn) < _UNLIKE)
        if unlike.size:
            raise ValueError(
                f"shape {unlike[0]} of {len(points)} is too unlike the others to be aligned: leave it out, "
                "or fit without alignment."
            )
        before, mean = mean, (plane / turn[:, None]).mean(axis=0)
        if np.linalg.norm(mean - before) < _CONVERGED * size:
            break
    # Up to here the heading is that of the first shape.
    heading = turn.sum() / abs(turn.sum()) if abs(turn.sum()) > _UNLIKE else 1.0
    flat = plane / turn[:, None] * heading
    return np.stack(
        [flat.real, flat.imag, *np.moveaxis(centred[..., 2:] / np.abs(turn)[:, None, None], -1, 0)], axis=-1
    )


def _turned(points: Array, turn: complex) -> Array:
    """Rotate and scale points ``(..., D)``."""
    out = points * abs(turn)
    x, y = points[..., 0], points[..., 1]
    out[..., 0] = turn.real * x - turn.imag * y
    out[..., 1] = turn.imag * x + turn.real * y
    return out


@dataclass(frozen=True, eq=False)
class PointDistribution:
    """A linear model of shapes, ``p = mean + sum_k c_k v_k`` plus noise.

    The coefficients c_k have the variances l_k, the noise has the variance s^2. An aligned model is
    ``p = t + s R (mean + sum_k c_k v_k)`` with any translation t, rotation R about the third axis and scale s.

    For points of equal weight the coefficients are projections, ``c_k = v_k (p - mean)``. With missing points they
    minimise ``sum_i w_i |p_i - model_i|^2 + (max(w) - mean(w)) g sum_k s^2 c_k^2 / l_k``, which keeps the unseen part
    probable. Sources: M. E. Tipping, C. M. Bishop, "Probabilistic Principal Component Analysis",
    Journal of the Royal Statistical Society B 61(3), 1999, section 3.2, for the prior s^2 / l_k; aligned: T. F. Cootes
    et al., "Active Shape Models: Their Training and Application", Computer Vision and Image Understanding 61(1), 1995,
    section 3.

    Args:
        mean: ``(N, D)`` mean shape, in the unit of the frame.
        components: ``(K, N, D)`` orthonormal directions v_k in order of decreasing variance.
        variance: ``(K,)`` variances of the coefficients, in squared units.
        noise: Variance s^2 of one coordinate, in squared units.
        layout: The topology of the points.
        frame: The coordinate frame of the points; see ``Coordinates``.
        origin: The origin of the points.
        aligned: Whether position, heading and size were removed before the fit.
        about: JSON values: ``shapes`` (the number of fitted shapes), ``explained`` (the share of the variance that each
            component explains), and the origin of the data.
    """

    mean: Array
    components: Array
    variance: Array
    noise: float
    layout: Topology
    frame: CoordinateFrame
    origin: str | None = None
    aligned: bool = False
    about: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def fit(
        cls,
        points: npt.ArrayLike,
        components: int = 6,
        *,
        layout: Topology,
        frame: CoordinateFrame = "camera",
        origin: str | None = None,
        aligned: bool = False,
        about: Mapping[str, Any] | None = None,
    ) -> PointDistribution:
        """Fit the model to shapes with scikit-learn.

        Args:
            points: (F, N, 2) or (F, N, 3): F shapes with all points measured, in the frame and relative to the origin.
            components: Number of components.
            layout: The topology of the shapes.
            frame: The coordinate frame of the points.
            origin: The origin of the points.
            aligned: Remove position, heading and size first.
            about: Further JSON values to store with the model.

        Raises:
            ValueError: The points do not fit the layout, some are unknown, or there are too many components.
        """
        points = np.asarray(points, dtype=np.float64)
        wanted = (layout.size, 2 if Coordinates(frame).planar else 3)
        if points.ndim != 3 or points.shape[1:] != wanted:
            raise ValueError(
                f"expected points (F, {wanted[0]}, {wanted[1]}) of {layout} in frame {frame!r}, got {points.shape}."
            )
        if not np.isfinite(points).all():
            raise ValueError("there are unknown points among the shapes: leave those shapes out.")
        if not 1 <= components < min(len(points), points[0].size):
            raise ValueError(
                f"components: expected 1 to {min(len(points), points[0].size) - 1} for {len(points)} shapes of "
                f"{points[0].size} coordinates, got {components}."
            )
        from sklearn.decomposition import PCA

        flat = (superimposed(points) if aligned else points).reshape(len(points), -1)
        pca = PCA(components, svd_solver="full").fit(flat)
        variance = pca.explained_variance_
        ways = np.count_nonzero(variance > max(_FLAT * variance[0], (_FLAT * np.ptp(flat)) ** 2))
        if ways < components:
            raise ValueError(f"the shapes differ in {ways} ways only: ask for at most {ways} components.")
        about = {"shapes": len(points), "explained": pca.explained_variance_ratio_.tolist(), **(about or {})}
        noise = max(float(pca.noise_variance_), _FLOOR * float(variance[-1]))
        mean, directions = flat.mean(axis=0).reshape(wanted), np.asarray(pca.components_).reshape(components, *wanted)
        return cls(mean, directions, variance, noise, layout, frame, origin, aligned, about)

    @property
    def unit(self) -> str:
        """The unit of the points."""
        return Coordinates(self.frame).unit

    @cached_property
    def placed(self) -> int:
        """Number of values that describe position, heading and size; 0 if the model is not aligned."""
        return 0 if not self.aligned else 2 + (0 if self.origin == "centroid" else self.mean.shape[1])

    @cached_property
    def design(self) -> Design:
        """The basis of the fit: the components, then the directions of translation, rotation and scale if free."""
        size = self.mean.shape[1]
        basis = list(self.components)
        if self.aligned or self.origin == "centroid":  # the centroid of the visible part is not that of the shape
            basis += [np.tile(axis, (len(self.mean), 1)) for axis in np.eye(size)]
        if self.aligned:
            x, y = self.mean[:, 0], self.mean[:, 1]
            basis += [_in_plane(x, y, size), _in_plane(-y, x, size)]
        bridge = np.full(len(basis), _FLOOR)
        bridge[: len(self.components)] = _CORRELATED * self.noise / self.variance
        return Design.of(np.stack([direction.ravel() for direction in basis], axis=1), bridge=np.diag(bridge))

    def values(self, points: Array, weight: Array) -> Array:
        """Return the values of a shape, of shape (placed + K,); NaN if fewer than two points are known.

        For an aligned model these are the shift (unless the origin is the centroid), the turn (s cos a, s sin a), and
        s c_k; all but the turn are in the unit of the points. Otherwise they are c_k.

        Args:
            points: ``(N, D)`` points.
            weight: ``(N,)`` weights of the points; 0 if unknown.
        """
        count, size = len(self.components), points.shape[1]
        known = np.count_nonzero(weight)
        if known < 2:
            return np.full(self.placed + count, np.nan)
        if known < len(weight):
            points = np.where(weight[:, None] > 0, points, self.mean)
        weights = np.repeat(weight, size)
        if not self.aligned:
            return self.design.fit((points - self.mean).reshape(-1, 1), weights)[:count, 0]
        pose, fitted = Similarity.of(points, self.mean, weight), np.zeros(count)
        whole = known == len(weight) and np.ptp(weight) == 0
        for _ in range(1 if whole else _ROUNDS):
            solved = self.design.fit((pose.undo(points) - self.mean).reshape(-1, 1), weights)[:, 0]
            fitted, shift, (grown, turned) = solved[:count], solved[count:-2], solved[-2:]
            if not whole:
                pose = Similarity(pose.apply(shift), pose.turn * complex(1 + grown, turned))
        heading = pose.turn.real, pose.turn.imag
        shift = () if self.origin == "centroid" else pose.shift
        return np.concatenate([shift, heading, abs(pose.turn) * fitted])

    def points(self, values: npt.ArrayLike) -> Array:
        """Return the points that the values describe, of shape ``(N, D)``."""
        values = np.asarray(values, dtype=np.float64)
        if values.shape != (self.placed + len(self.components),):
            raise ValueError(f"expected {self.placed + len(self.components)} values, got shape {values.shape}.")
        fitted = values[self.placed :]
        if not self.aligned:
            return self.mean + np.tensordot(fitted, self.components, axes=1)
        turn = complex(values[self.placed - 2], values[self.placed - 1])
        shift = values[: self.placed - 2] if self.placed > 2 else np.zeros(self.mean.shape[1])
        scale = abs(turn) or 1.0
        return Similarity(shift, turn).apply(self.mean + np.tensordot(fitted / scale, self.components, axes=1))

    def save(self, path: str | Path) -> None:
        """Write the model as ``.npz``, completely or not at all; equal models give equal files.

        Raises:
            ValueError: The suffix is not ``.npz``.
            OSError: The file cannot be written.
        """
        path = Path(path)
        if path.suffix != ".npz":
            raise ValueError(f"{path}: expected a file named *.npz.")
        make_folder(path.parent)
        kind = next(name for name, made in _LAYOUTS.items() if type(self.layout) is made)
        head = {"format": FORMAT, "version": VERSION, "layout": {"kind": kind, **asdict(self.layout)}}  # type: ignore[call-overload]
        head |= {name: getattr(self, name) for name in ("frame", "origin", "aligned", "unit")}
        text = json.dumps({**head, "about": dict(self.about)})
        arrays = {name: np.asarray(getattr(self, name)) for name in _ARRAYS}
        write_whole(path, lambda temporary: _write(temporary, {"metadata": np.array(text), **arrays}))

    @classmethod
    def load(cls, path: str | Path) -> PointDistribution:
        """Read a file that ``save`` wrote.

        Raises:
            FileNotFoundError: There is no such file.
            ValueError: The file contains something else, or is damaged.
        """
        return cls.from_bytes(read_bytes(Path(path)), str(path))

    @classmethod
    def from_bytes(cls, content: bytes, name: str) -> PointDistribution:
        """Read the content of a file named ``name``, which error messages contain; raises what ``load`` raises."""
        try:
            arrays = decode_npz(content, "content", most_bytes=_MOST_BYTES)
            head = parse_json(str(arrays["metadata"]), "metadata")
            mean, components, variance, noise = (np.asarray(arrays[key], dtype=np.float64) for key in _ARRAYS)
            if head.get("format") != FORMAT or head["version"] != VERSION:
                raise ValueError(f"expected {FORMAT!r} {VERSION}, got {head.get('format')!r} {head.get('version')}")
            layout = _LAYOUTS[head["layout"].pop("kind")](**head["layout"])
            coordinates = Coordinates(head["frame"], head["origin"])
            size = (layout.size, 2 if coordinates.planar else 3)
            if coordinates.frame not in _FRAMES or not isinstance(head["aligned"], bool):
                raise ValueError(f"unknown frame {head['frame']!r}, or 'aligned' is neither true nor false")
            if mean.shape != size or components.shape != (len(variance), *size) or noise.shape != ():
                raise ValueError(f"arrays of {mean.shape} and {components.shape} do not belong to {layout}")
            if not all(np.isfinite(array).all() for array in (mean, components)) or not min(variance.min(), noise) > 0:
                raise ValueError("it holds numbers that are not finite, or variances that are not positive")
            about = (head["frame"], head["origin"], head["aligned"], head["about"])
        except (KeyError, ValueError, TypeError, AttributeError) as error:
            raise ValueError(
                f"{name}: not a file of principal components, or a damaged one: {error}. "
                "`shape-obs fit-features` makes such files."
            ) from error
        return cls(mean, components, variance, float(noise), layout, *about)


#: Contents of fitted files without a file, by name.
_HELD: Final = dict[str, bytes]()


def hold(content: bytes) -> str:
    """Keep the content of a fitted file in memory; return the name, ``"sha256:..."``, by which features read it."""
    name = f"sha256:{hashlib.sha256(content).hexdigest()}"
    _HELD[name] = content
    return name


def read_bytes(path: Path) -> bytes:
    """Return the content of a fitted file, which may be in memory.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The path is a folder.
    """
    if (held := _HELD.get(str(path))) is not None:
        return held
    try:
        return path.read_bytes()
    except FileNotFoundError as error:
        raise FileNotFoundError(f"{path}: no such file; `shape-obs fit-features -o {path}` makes one.") from error
    except IsADirectoryError as error:
        raise ValueError(f"{path}: expected a file, got a folder.") from error


def _in_plane(x: Array, y: Array, size: int) -> Array:
    return np.stack([x, y, *np.zeros((size - 2, len(x)))], axis=1)


def _write(path: Path, arrays: Mapping[str, Any]) -> None:
    with path.open("wb") as file:
        np.savez(file, **arrays)
