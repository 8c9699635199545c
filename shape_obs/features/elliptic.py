"""Elliptic Fourier: a closed curve as a sum of ellipses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shape_obs.features.fourier import harmonic_basis
from shape_obs.features.linear import LinearFit
from shape_obs.spec import SpecError
from shape_obs.topology import Ring, Topology

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class EllipticFourier(LinearFit, kind="elliptic_fourier"):
    """A_0, a_1, b_1, a_2, ... of p(t) = A_0 + sum_k a_k cos(k t) + b_k sin(k t) at t_i = 2 pi i / N, each a point.

    Each pair is an ellipse run through k times (Kuhl & Giardina, 'Elliptic Fourier features of a closed contour',
    Computer Graphics and Image Processing 1982; their a, c are our a_k's coordinates, their b, d our b_k's).
    They integrate along the polygon's sides, where this takes the points: for equidistant ones theirs are ours times
    (sin(x) / x)^2 with x = pi k / N. A_0 is the mean of the points.

    Translation changes A_0 alone, rotation turns every coefficient. A start s points further on turns the pair
    (a_k, b_k) by the angle 2 pi k s / N; run the other way round from the same start, b_k changes sign. Their
    normalisation for start, rotation and size is not made: it is no linear function of the points, and where the first
    ellipse is near a circle it leaps. Anchor the contour instead.

    Args:
        frame: ``"pixels"``, ``"normalized"``, ``"camera"`` or ``"base"``; see ``Coordinates``.
        origin: None, ``"centroid"``, ``"anchor"`` or the name of a published anchor.
        max_depth: Metres; how far the camera's view is taken to reach when bounds are made.
        harmonics: How many ellipses.
    """

    harmonics: int = 4

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.harmonics < 1:
            raise SpecError(f"elliptic_fourier: needs at least 1 harmonic, got {self.harmonics}.")

    def basis(self, layout: Topology) -> Array:
        """(N, 2 harmonics + 1).

        Raises:
            ValueError: No ring, or more functions than points.
        """
        if not isinstance(layout, Ring):
            raise ValueError(f"feature {self.kind!r} is of rings, got {layout!r}: use 'fourier'.")
        return harmonic_basis(2 * np.pi * np.arange(layout.count) / layout.count, self.harmonics)
