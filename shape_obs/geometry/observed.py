"""What shapes are fitted to: the protocol that a region of an image and a cloud of points share, and their samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Final, Protocol

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.curve import FittedCurve

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

MIN_SAMPLES: Final = 16  # pixels or points: with fewer there is no object
MAD_SIGMA: Final = 1.4826  # standard deviation of normally distributed values, in median absolute deviations


@dataclass(frozen=True)
class Samples:
    """Weighted points.

    Args:
        points: ``(M, D)`` centroids: pixels for D = 2, metres for D = 3.
        weight: ``(M,)`` how many pixels (points) each stands for.
        scale: Edge of the cells, in the unit of ``points``.
    """

    points: Array
    weight: Array
    scale: float

    def __len__(self) -> int:
        return len(self.points)


class Observed(Protocol):
    """One object as it was observed: the mask of a region in pixels, or a cloud of points in metres.

    Attributes:
        unit: ``"px"`` or ``"m"``.
        noun: ``"mask"`` or ``"cloud"``, for messages.
        sample_unit: ``"pixels"`` or ``"points"``, for messages.
        dimension: 2 for pixels, 3 for metres.
    """

    unit: ClassVar[str]
    noun: ClassVar[str]
    sample_unit: ClassVar[str]
    dimension: ClassVar[int]

    @property
    def refusal(self) -> str:
        """Why what was seen is no object, in words; empty if it may be one."""
        ...

    @property
    def resolution(self) -> float:
        """The least distance that is resolved."""
        ...

    @property
    def pieces(self) -> int:
        """How many connected pieces there are."""
        ...

    @property
    def area(self) -> int:
        """How many pixels or points there are."""
        ...

    @property
    def width(self) -> float:
        """Width of the object if it is rope-like."""
        ...

    @property
    def length(self) -> float:
        """Length of the object if it is rope-like."""
        ...

    @property
    def box(self) -> Any:
        """The window around all pixels; None for a cloud."""
        ...

    @property
    def outlined_share(self) -> float:
        """The share of the object that its outline goes around."""
        ...

    @property
    def parts(self) -> tuple[Any, ...]:
        """The object itself, and if it is a cloud under a mask that mask."""
        ...

    def outline_curve(self, hole: int | None = None) -> FittedCurve:
        """Return the outline of the largest piece, or of one of its holes, clockwise as seen."""
        ...

    def outline_points(self, hole: int | None = None) -> Samples:
        """Return the points of the outline, each counting once."""
        ...

    def sheet_outline(self) -> tuple[Array, Array]:
        """Return the outline of the object as a sheet, ``(P, D)``, and unrolled into a plane, ``(P, 2)``."""
        ...

    def to_space(self, flat: Array) -> Array:
        """Return places ``(N, 2)`` on the unrolled sheet where they are observed: ``(N, D)``."""
        ...

    def gather(self, edge: float) -> Samples:
        """Return weighted points in cells of an edge, pixels; a cloud keeps its voxels."""
        ...

    def all_samples(self) -> Samples:
        """Return every pixel or point, each counting once."""
        ...

    def seen(self, points: Array, target: Array | None) -> Array:
        """Return points as numbering sees them: pixels if there is an image."""
        ...

    def carries(self, points: Array) -> Mask:
        """Return whether there is a pixel or a point at each of ``(N, D)`` places: ``(N,)``."""
        ...
