"""Control points of B-spline and Bezier curves, closed curves and sheets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shape_obs.features.basis import LinearFit, open_counts, products
from shape_obs.geometry.topology import Ring, Topology
from shape_obs.spec import SpecError

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class BSpline(LinearFit, kind="bspline"):
    """Control points c_j of the B-spline p(s) = sum_j c_j N_j(s), by least squares at s_i = i / (N - 1).

    N_j are the B-splines of degree d (de Boor, 'A practical guide to splines', ch. IX). The end knots are repeated, so
    that the curve runs from the first control point to the last. The inner knots are averages of d neighbours among as
    many equidistant sites as there are coefficients (Piegl & Tiller, 'The NURBS book', eq. 9.8; for cubics those of a
    not-a-knot spline): they are uniform except for longer spans at the ends. With equal spans the error on bent cables
    is 1.3 to 1.9 times as large. A ring has periodic B-splines with uniform knots, at s_i = i / N.

    A lattice has products, p(s, t) = sum_jk c_jk N_j(s) N_k(t) with s down the rows and t along the columns, c_jk row
    by row. The number and the degree of the functions in each direction are limited by its number of points. Points
    are equidistant, so s is the position along the curve. A control point affects only the part of the curve near it.

    Translation and rotation transform control points like points; reversing the points reverses the control points. The
    fit to such a spline returns its own control points, that to a straight line its points at the Greville abscissae.

    Args:
        frame: ``"pixels"``, ``"normalized"``, ``"camera"`` or ``"base"``; see ``Coordinates``.
        origin: None, ``"centroid"``, ``"anchor"`` or the name of a published anchor.
        max_depth: Depth in metres up to which the camera's view is taken into account for bounds.
        coefficients: Number of control points; on a lattice in each direction.
        degree: Degree of the pieces; 3 is cubic, with two continuous derivatives.
    """

    coefficients: int = 8
    degree: int = 3

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.degree < self.coefficients:
            raise SpecError(
                f"bspline: needs a degree of at least 1 and more coefficients than that, got degree={self.degree} and "
                f"coefficients={self.coefficients}."
            )

    def basis(self, layout: Topology) -> Array:
        """Return the functions, of shape (N, coefficients); for a lattice their products.

        Raises:
            ValueError: There are more coefficients than points.
        """
        if isinstance(layout, Ring):
            return periodic(layout.count, self.coefficients, self.degree)
        counts = open_counts(layout, self.kind, "a chain or a lattice")
        if len(counts) == 1:
            return clamped(counts[0], self.coefficients, self.degree)
        return products(clamped(n, min(self.coefficients, n), min(self.degree, n - 1)) for n in counts)


@dataclass(frozen=True)
class Bezier(LinearFit, kind="bezier"):
    """Control points c_j of the Bezier curve p(s) = sum_j c_j B_j(s), by least squares at s_i = i / (N - 1).

    B_j(s) = binom(n, j) s^j (1 - s)^(n - j) are the Bernstein polynomials of degree n (Farin, 'Curves and surfaces for
    CAGD', ch. 5-6). A lattice has their products, p(s, t) = sum_jk c_jk B_j(s) B_k(t) with s down the rows and t along
    the columns, c_jk row by row; in each direction the degree is less than the number of points. Points are
    equidistant, so s is the position along the curve.

    Translation and rotation transform control points like points; reversing the points reverses the control points.
    Every control point affects the whole curve. The higher the degree, the further control points lie from the curve:
    each additional degree about doubles their noise, and a missing end makes them oscillate. ``bspline`` has neither
    problem.

    Args:
        frame: ``"pixels"``, ``"normalized"``, ``"camera"`` or ``"base"``; see ``Coordinates``.
        origin: None, ``"centroid"``, ``"anchor"`` or the name of a published anchor.
        max_depth: Depth in metres up to which the camera's view is taken into account for bounds.
        degree: Degree of the polynomial, one less than the number of control points.
    """

    degree: int = 5

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.degree < 1:
            raise SpecError(f"bezier: needs a degree of at least 1, got {self.degree}.")

    def basis(self, layout: Topology) -> Array:
        """Return the functions, of shape (N, degree + 1); for a lattice their products.

        Raises:
            ValueError: The layout is a ring, or has fewer points than control points.
        """
        counts = open_counts(layout, self.kind, "'elliptic_fourier' or 'bspline'")
        degrees = [self.degree if len(counts) == 1 else min(self.degree, n - 1) for n in counts]
        return products(clamped(n, degree + 1, degree) for n, degree in zip(counts, degrees, strict=True))


def clamped(points: int, coefficients: int, degree: int) -> Array:
    """Return the B-splines on 0...1 with repeated end knots at equidistant places, of shape (points, coefficients).

    The inner knots are averages of equidistant sites. With degree + 1 coefficients there are none, and the B-splines
    are Bernstein polynomials.
    """
    within = (np.arange(1, coefficients - degree) + 0.5 * (degree - 1)) / (coefficients - 1)
    knots = np.pad(within, degree + 1, constant_values=(0.0, 1.0))
    return b_splines(np.linspace(0.0, 1.0, points), knots, degree)


def periodic(points: int, coefficients: int, degree: int) -> Array:
    """Return the periodic B-splines with uniform knots, of shape (points, coefficients).

    They are evaluated at equidistant places, the first of which is a knot.
    """
    knots = np.arange(-degree, coefficients + degree + 1, dtype=np.float64)
    unrolled = b_splines(np.arange(points) * coefficients / points, knots, degree)
    rolled = unrolled[:, :coefficients].copy()
    rolled[:, :degree] += unrolled[:, coefficients:]
    return rolled


def b_splines(places: Array, knots: Array, degree: int) -> Array:
    """Return the values of all B-splines over the knots, of shape (places, len(knots) - degree - 1).

    Args:
        places: ``(P,)`` where the splines are evaluated, between ``knots[degree]`` and ``knots[-degree - 1]``.
        knots: Non-decreasing knots.
        degree: The degree of the splines.
    """
    from scipy.interpolate import BSpline as Curve  # takes 0.2 s to import, and few need it

    return Curve.design_matrix(places, knots, degree).toarray()
