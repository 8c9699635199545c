"""Bezier: control points of one polynomial curve or sheet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shape_obs.features.bspline import clamped
from shape_obs.features.linear import LinearFit, open_counts, products
from shape_obs.spec import SpecError
from shape_obs.topology import Topology

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Bezier(LinearFit, kind="bezier"):
    """Control points c_j of the curve p(s) = sum_j c_j B_j(s), by least squares at s_i = i / (N - 1).

    B_j(s) = binom(n, j) s^j (1 - s)^(n - j) are Bernstein's polynomials of degree n (Farin, 'Curves and surfaces for
    CAGD', ch. 5-6). A lattice has their products, p(s, t) = sum_jk c_jk B_j(s) B_k(t) with s down the rows and t along
    the columns, c_jk row by row; in each direction the degree is at most one less than there are points. Points are
    equidistant, so s is the place along the curve.

    Translation and rotation move control points like points; reversing the points reverses the control points. Every
    control point moves the whole curve, and the more of them, the further they swing from it: each degree more about
    doubles how strongly the noise of the points shows in them, and where an end is missing it swings. ``bspline`` has
    neither.

    Args:
        frame: ``"pixels"``, ``"normalized"``, ``"camera"`` or ``"base"``; see ``Coordinates``.
        origin: None, ``"centroid"``, ``"anchor"`` or the name of a published anchor.
        max_depth: Metres; how far the camera's view is taken to reach when bounds are made.
        degree: Of the polynomial, one less than there are control points.
    """

    degree: int = 5

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.degree < 1:
            raise SpecError(f"bezier: needs a degree of at least 1, got {self.degree}.")

    def basis(self, layout: Topology) -> Array:
        """(N, degree + 1); (N, rows' x columns') of a lattice.

        Raises:
            ValueError: A ring, or more control points than points.
        """
        counts = open_counts(layout, self.kind, "'elliptic_fourier' or 'bspline'")
        degrees = [self.degree if len(counts) == 1 else min(self.degree, n - 1) for n in counts]
        return products(clamped(n, degree + 1, degree) for n, degree in zip(counts, degrees, strict=True))
