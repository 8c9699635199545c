"""Fourier coefficients of open curves and sheets, and elliptic Fourier coefficients of closed curves."""

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


#: Weight of the roughness of the extended curve, per point.
ROUGHNESS: Final = 1e-5


@dataclass(frozen=True)
class Fourier(LinearFit, kind="fourier"):
    """Fourier coefficients A_0, a_1, b_1, a_2, ... of an open curve or a sheet, each a point.

    The curve is p(r) = A_0 + sum_k a_k cos(k r) + b_k sin(k r) at r_i = pi i / (N - 1). These are the Fourier features
    of shape servoing (Navarro-Alarcon & Liu, 'Fourier-based shape servoing', IEEE T-RO 2018, for contours; Zhu et al.,
    'Dual-arm robotic manipulation of flexible cables', IROS 2018, for cables), but on half a period: on a full period
    the ends of a straight cable would have to meet. The curve continues over the other half and closes there (the
    Fourier extension of Huybrechs, 'On the Fourier extension of nonperiodic functions', SIAM Journal on Numerical
    Analysis 2010). On half a period sines and cosines are nearly dependent, and plain least squares would give huge
    coefficients. So the smoothest extension is chosen::

        minimise  sum_i |p_i - p(r_i)|^2 + 1e-5 N sum_k k^4 (|a_k|^2 + |b_k|^2)

    The second sum is (1/pi) times the integral of ``|p''|^2`` over the full period. With 4 harmonics and 20 points, the
    noise of a coefficient is then at most 6 times that of the points instead of 70 times, and a straight line is
    reconstructed to 0.2 % of its length instead of exactly.

    A lattice has the products of the functions down its rows and along its columns, where the columns vary fastest, and
    (k^2 + l^2)^2 in place of k^4. It has ``harmonics`` in each direction, but at most half as many as it has points
    there, and no more functions than points in total: 4 x 8 points have 5 x 5 functions.

    Translation changes only A_0, rotation rotates every coefficient, and reversing the points maps (a_k, b_k) to
    (-1)^k (a_k, -b_k).

    Args:
        frame: ``"pixels"``, ``"normalized"``, ``"camera"`` or ``"base"``; see ``Coordinates``.
        origin: None, ``"centroid"``, ``"anchor"`` or the name of a published anchor.
        max_depth: Depth in metres up to which the camera's view is taken into account for bounds.
        harmonics: Number of harmonics; there are 2 harmonics + 1 functions.
    """

    harmonics: int = 4

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.harmonics < 1:
            raise SpecError(f"fourier: needs at least 1 harmonic, got {self.harmonics}.")

    def basis(self, layout: Topology) -> Array:
        """Return the functions, of shape (N, 2 harmonics + 1); for a lattice their products.

        Raises:
            ValueError: The layout is a ring, or has fewer points than functions.
        """
        return products(harmonic_basis(np.linspace(0.0, np.pi, n), most) for n, most in self._directions(layout))

    def penalty(self, layout: Topology) -> Array:
        """Return the roughness of the extended curve as a matrix ``(K, K)``."""
        squares = [np.repeat(np.arange(most + 1.0), 2)[1:] ** 2 for _, most in self._directions(layout)]
        return np.diag(ROUGHNESS * layout.size * np.ravel(reduce(np.add.outer, squares)) ** 2)

    def _directions(self, layout: Topology) -> list[tuple[int, int]]:
        """Return the numbers of points and of harmonics in each direction."""
        counts = open_counts(layout, self.kind, "'elliptic_fourier'")
        if len(counts) == 1:
            return [(counts[0], self.harmonics)]
        for most in range(self.harmonics, 0, -1):
            directions = [(n, min(most, n // 2)) for n in counts]
            if prod(2 * harmonics + 1 for _, harmonics in directions) <= layout.size:
                return directions
        raise ValueError(
            f"feature {self.kind!r} needs at least 9 points on a lattice, got {layout!r}: use more points."
        )


def harmonic_basis(angle: Array, harmonics: int) -> Array:
    """Return 1, cos(t), sin(t), cos(2 t), sin(2 t), ... at N angles in radians, of shape (N, 2 harmonics + 1)."""
    phase = angle[:, None] * np.arange(1, harmonics + 1)
    waves = np.stack([np.cos(phase), np.sin(phase)], axis=2).reshape(len(angle), -1)
    return np.concatenate([np.ones((len(angle), 1)), waves], axis=1)


@dataclass(frozen=True)
class EllipticFourier(LinearFit, kind="elliptic_fourier"):
    """Elliptic Fourier coefficients A_0, a_1, b_1, a_2, ... of a closed curve, each a point.

    The curve is p(t) = A_0 + sum_k a_k cos(k t) + b_k sin(k t) at t_i = 2 pi i / N. Each pair is an ellipse that is
    traversed k times (Kuhl & Giardina, 'Elliptic Fourier features of a closed contour', Computer Graphics and Image
    Processing 1982; their a, c are the coordinates of a_k, their b, d those of b_k). They integrate along the sides of
    the polygon, while this feature sums over the points: for equidistant points their coefficients equal these times
    (sin(x) / x)^2 with x = pi k / N. A_0 is the mean of the points.

    Translation changes only A_0, rotation rotates every coefficient. A start s points later rotates the pair (a_k, b_k)
    by the angle 2 pi k s / N; the opposite direction from the same start changes the sign of b_k. The coefficients are
    not normalised for start, rotation and size: the normalisation is not linear in the points, and jumps where the
    first ellipse is nearly a circle. Anchor the contour instead.

    Args:
        frame: ``"pixels"``, ``"normalized"``, ``"camera"`` or ``"base"``; see ``Coordinates``.
        origin: None, ``"centroid"``, ``"anchor"`` or the name of a published anchor.
        max_depth: Depth in metres up to which the camera's view is taken into account for bounds.
        harmonics: Number of ellipses.
    """

    harmonics: int = 4

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.harmonics < 1:
            raise SpecError(f"elliptic_fourier: needs at least 1 harmonic, got {self.harmonics}.")

    def basis(self, layout: Topology) -> Array:
        """Return the functions, of shape (N, 2 harmonics + 1).

        Raises:
            ValueError: The layout is not a ring, or has fewer points than functions.
        """
        if not isinstance(layout, Ring):
            raise ValueError(f"feature {self.kind!r} is for rings, got {layout!r}: use 'fourier'.")

        return harmonic_basis(2 * np.pi * np.arange(layout.count) / layout.count, self.harmonics)
