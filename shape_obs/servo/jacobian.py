"""Estimate the Jacobian from actions to features while moving: Broyden, Kalman filter, RLS and pseudo-Jacobian."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class JacobianEstimator(ABC):
    """Estimate the matrix J ``(F, A)`` in ``delta_features = J delta_action`` from pairs of changes.

    All rows are updated alike, so the units of the features do not matter; actions are -1...1.

    Attributes:
        matrix: J of shape ``(F, A)``; None before ``start``.
        error: Relative prediction error of the last change of features, ``|df - J da| / |df|``; NaN before the first.
    """

    matrix: Array | None
    error: float

    def __init__(self) -> None:
        self.matrix = None
        self.error = float("nan")

    def start(self, features: int, actions: int, matrix: npt.ArrayLike | None = None) -> None:
        """Reset the estimate.

        Args:
            features: Number of features F.
            actions: Number of actions A.
            matrix: Initial J of shape ``(F, A)``; default zeros.

        Raises:
            ValueError: The matrix has another shape, or is not finite.
        """
        begin = np.zeros((features, actions)) if matrix is None else np.array(matrix, dtype=np.float64)
        if begin.shape != (features, actions) or not np.all(np.isfinite(begin)):
            raise ValueError(f"expected a finite Jacobian ({features}, {actions}), got shape {begin.shape}.")
        self.matrix, self.error = begin, float("nan")
        self._begin(actions)

    def update(
        self,
        delta_features: npt.ArrayLike,
        delta_action: npt.ArrayLike,
        measured: npt.NDArray[np.bool_] | None = None,
    ) -> bool:
        """Update the estimate from a change of features and the actions that caused it.

        Args:
            delta_features: ``(F,)`` change of the features.
            delta_action: ``(A,)`` sum of the actions.
            measured: ``(F,)`` which features to learn from; None for all.

        Returns:
            Whether the estimate was updated, for which changes must be finite and the motion not zero.

        Raises:
            ValueError: ``start`` was not called, or a size is wrong.
        """
        if self.matrix is None:
            raise ValueError("estimator: call start(features, actions) first.")
        df, da = np.asarray(delta_features, dtype=np.float64), np.asarray(delta_action, dtype=np.float64)
        if df.shape != self.matrix.shape[:1] or da.shape != self.matrix.shape[1:]:
            raise ValueError(
                f"estimator: expected changes of {self.matrix.shape[0]} features and {self.matrix.shape[1]} "
                f"actions, got {df.shape} and {da.shape}."
            )
        square = da @ da
        if not (np.isfinite(square) and square > 0 and np.all(np.isfinite(df))):
            return False
        residual = df - self.matrix @ da
        if measured is not None:
            residual = np.where(measured, residual, 0.0)
        self.error = float(np.linalg.norm(residual) / max(np.linalg.norm(df), 1e-12))
        self.matrix = self.matrix + np.outer(residual, self._gain(da))
        return True

    def _begin(self, actions: int) -> None:
        """Reset the state of a subclass. The default does nothing."""
        return

    @abstractmethod
    def _gain(self, da: Array) -> Array:
        """Return the gain ``(A,)`` of a motion in the update ``J += (df - J da) gain'``."""


def check_in_range(name: str, value: float, most: float = 1.0) -> float:
    """Return a number after checking that it is above 0 and at most ``most``.

    Raises:
        ValueError: The value is outside this range, or not a number.
    """
    if not (isinstance(value, (int, float)) and not isinstance(value, bool) and 0 < value <= most):
        raise ValueError(f"{name}: expected a number above 0, at most {most:g}, got {value!r}.")
    assert math.isfinite(value)
    return float(value)


class Broyden(JacobianEstimator):
    """Broyden's update, a fraction of the smallest change of J that explains the last motion.

    ``gain = g da / (da'da + e)``: Broyden, 'A class of methods for solving nonlinear simultaneous equations',
    Mathematics of Computation 1965, eq. 4.5; damped as in Jagersand, Fuentes and Nelson, 'Experimental evaluation of
    uncalibrated visual servoing for precision manipulation', ICRA 1997.

    Args:
        gain: g, 0...1: smaller values suppress noise, larger ones adapt faster.
        floor: e, which reduces the effect of small motions.
    """

    def __init__(self, gain: float = 0.5, floor: float = 0.02) -> None:
        super().__init__()
        self.gain, self.floor = check_in_range("Broyden: gain", gain), check_in_range("Broyden: floor", floor, 1e6)

    def _gain(self, da: Array) -> Array:
        return self.gain * da / (da @ da + self.floor)


class Kalman(JacobianEstimator):
    """A Kalman filter whose state J is a random walk that motions measure.

    ``P += q I``, ``gain = P da / (r + da'P da)``, ``P -= gain da'P``. All rows share one covariance P (A, A), since one
    motion measures all of them. Qian and Su, 'Online estimation of image Jacobian matrix by Kalman-Bucy filter for
    uncalibrated stereo vision feedback', ICRA 2002.

    Args:
        drift: q, the variance that J gains between two updates, on the scale of ``uncertainty``.
        noise: r, the variance of a measured change.
        uncertainty: The initial P is this times the identity.
    """

    def __init__(self, drift: float = 0.02, noise: float = 0.05, uncertainty: float = 10.0) -> None:
        super().__init__()
        self.drift = check_in_range("Kalman: drift", drift, 1e6)
        self.noise = check_in_range("Kalman: noise", noise, 1e6)
        self.uncertainty = check_in_range("Kalman: uncertainty", uncertainty, 1e6)

    def _begin(self, actions: int) -> None:
        self._covariance = self.uncertainty * np.eye(actions)

    def _gain(self, da: Array) -> Array:
        before = self._covariance + self.drift * np.eye(len(da))
        spread = before @ da
        gain = spread / (self.noise + da @ spread)
        after = before - np.outer(gain, spread)
        self._covariance = (after + after.T) / 2
        return gain


class RecursiveLeastSquares(JacobianEstimator):
    """Recursive least squares: the J that fits all motions best, with smaller weights for older ones.

    ``gain = P da / (f + da'P da)``, then ``P = (P - gain da'P) / f``: Astrom and Wittenmark, 'Adaptive Control', 1995,
    section 2.2; for Jacobians Hosoda and Asada, 'Versatile visual servoing without knowledge of true Jacobian', IROS
    1994.

    Args:
        forgetting: f, 0...1: the weight of a motion decreases by this factor with each later one.
        uncertainty: The initial P is this times the identity, and no eigenvalue of P exceeds it. Otherwise directions
            without motion would become so uncertain that noise determines them.
    """

    def __init__(self, forgetting: float = 0.95, uncertainty: float = 10.0) -> None:
        super().__init__()
        self.forgetting = check_in_range("RecursiveLeastSquares: forgetting", forgetting)
        self.uncertainty = check_in_range("RecursiveLeastSquares: uncertainty", uncertainty, 1e6)

    def _begin(self, actions: int) -> None:
        self._covariance = self.uncertainty * np.eye(actions)

    def _gain(self, da: Array) -> Array:
        before = self._covariance
        spread = before @ da
        gain = spread / (self.forgetting + da @ spread)
        values, vectors = np.linalg.eigh((before - np.outer(gain, spread)) / self.forgetting)
        # Limit each eigenvalue: scaling all of P would stop forgetting along all directions while one is at rest.
        self._covariance = (vectors * np.clip(values, 0.0, self.uncertainty)) @ vectors.T
        return gain


class PseudoJacobian(JacobianEstimator):
    """The pseudo-Jacobian of model-free adaptive control, a projection with ``gain = eta da / (mu + da'da)``.

    Hou and Jin, 'Data-driven model-free adaptive control for a class of MIMO nonlinear discrete-time systems', IEEE
    Transactions on Neural Networks 2011, eq. 11 (compact form). It differs from ``Broyden`` in the large ``mu``, which
    reduces the effect of small motions and their noise. The original is reset when it leaves the cone that the proof of
    stability needs, which assumes a square matrix; here ``ServoLaw.ready`` checks the estimate, for any F and A.

    Args:
        eta: Step size, 0...1.
        mu: Penalty on changes.
    """

    def __init__(self, eta: float = 0.5, mu: float = 0.2) -> None:
        super().__init__()
        self.eta, self.mu = check_in_range("PseudoJacobian: eta", eta), check_in_range("PseudoJacobian: mu", mu, 1e6)

    def _gain(self, da: Array) -> Array:
        return self.eta * da / (self.mu + da @ da)
