"""Fourier: an open curve or a sheet as a sum of half-period harmonics.

Elliptic Fourier: a closed curve as a sum of ellipses.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from math import prod
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.features.basis import LinearFit, open_counts, products
from shape_obs.geometry.topology import Ring, Topology
from shape_obs.spec import SpecError

Array = npt.NDArray[np.float64]


#: Of the roughness of the extended curve, for each point.
ROUGHNESS: Final = 1e-5


@dataclass(frozen=True)
class Fourier(LinearFit, kind="fourier"):
    """A_0, a_1, b_1, a_2, ... of p(r) = A_0 + sum_k a_k cos(k r) + b_k sin(k r) at r_i = pi i / (N - 1), each a point.

    The Fourier features of shape servoing (Navarro-Alarcon & Liu, 'Fourier-based shape servoing', IEEE T-RO 2018, for
    contours; Zhu et al., 'Dual-arm robotic manipulation of flexible cables', IROS 2018, for cables), but on half a
    period: on a full one the ends of a straight cable would have to meet. The curve goes on, unseen, for the other half
    and closes there (the Fourier extension of Huybrechs, 'On the Fourier extension of nonperiodic functions', SIAM
    Journal on Numerical Analysis 2010). How is left open, sines and cosines are nearly dependent on the half that is
    seen, and least squares alone would blow them up. So the extension is to be the smoothest one::

        minimise  sum_i |p_i - p(r_i)|^2 + 1e-5 N sum_k k^4 (|a_k|^2 + |b_k|^2)

    whose sum is (1/pi) times the integral of ``|p''|^2`` over the full period. With 4 harmonics and 20 points a
    coefficient has then up to 6 times the points' noise, not 70 times, and a straight line comes back to 0.2 % of its
    length, not exactly.

    A lattice has the products of the functions down its rows and along its columns, the columns' running fastest, and
    (k^2 + l^2)^2 for k^4: ``harmonics`` in each direction, but at most half as many as it has points there, and no more
    functions in all than points. 4 x 8 points have 5 x 5.

    Translation changes A_0 alone, rotation turns every coefficient, and reversing the points takes (a_k, b_k) to
    (-1)^k (a_k, -b_k).

    Args:
        frame: ``"pixels"``, ``"normalized"``, ``"camera"`` or ``"base"``; see ``Coordinates``.
        origin: None, ``"centroid"``, ``"anchor"`` or the name of a published anchor.
        max_depth: Depth in metres up to which the camera's view is taken into account for bounds.
        harmonics: How many; 2 harmonics + 1 functions.
    """

    harmonics: int = 4

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.harmonics < 1:
            raise SpecError(f"fourier: needs at least 1 harmonic, got {self.harmonics}.")

    def basis(self, layout: Topology) -> Array:
        """(N, 2 harmonics + 1); (N, rows' x columns') of a lattice.

        Raises:
            ValueError: A ring, or more functions than points.
        """
        return products(harmonic_basis(np.linspace(0.0, np.pi, n), most) for n, most in self._directions(layout))

    def penalty(self, layout: Topology) -> Array:
        """(K,K) the roughness of the extended curve."""
        squares = [np.repeat(np.arange(most + 1.0), 2)[1:] ** 2 for _, most in self._directions(layout)]
        return np.diag(ROUGHNESS * layout.size * np.ravel(reduce(np.add.outer, squares)) ** 2)

    def _directions(self, layout: Topology) -> list[tuple[int, int]]:
        """How many points, and how many harmonics, in each direction."""
        counts = open_counts(layout, self.kind, "'elliptic_fourier'")
        if len(counts) == 1:
            return [(counts[0], self.harmonics)]
        for most in range(self.harmonics, 0, -1):
            directions = [(n, min(most, n // 2)) for n in counts]
            if prod(2 * harmonics + 1 for _, harmonics in directions) <= layout.size:
                return directions
        raise ValueError(
            f"feature {self.kind!r} has at least 9 functions on a lattice, got {layout!r}: use more points."
        )


def harmonic_basis(angle: Array, harmonics: int) -> Array:
    """(N, 2 harmonics + 1) 1, cos(t), sin(t), cos(2 t), sin(2 t), ... at (N,) angles, radians."""
    phase = angle[:, None] * np.arange(1, harmonics + 1)
    waves = np.stack([np.cos(phase), np.sin(phase)], axis=2).reshape(len(angle), -1)
    return np.concatenate([np.ones((len(angle), 1)), waves], axis=1)


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
        max_depth: Depth in metres up to which the camera's view is taken into account for bounds.
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
