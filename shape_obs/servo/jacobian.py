"""How features answer to actions, learnt while moving: what all estimators of that have in common.

Checks of numbers that a law is told.

Broyden's rank-one update.

A Kalman filter over the Jacobian.

Recursive least squares with forgetting.

Model-free adaptive control's estimate of the pseudo-Jacobian.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class JacobianEstimator(ABC):
    """The matrix J (F,A) in ``delta_features = J delta_action``, from pairs of the two.

    What features are measured in does not matter to any of them, since all rows learn alike; actions are -1...1.

    Attributes:
        matrix: (F,A) J; None before ``start``.
        error: Share of the last change of features that was not foreseen, ``|df - J da| / |df|``; NaN before the first.
    """

    def __init__(self) -> None:
        self.matrix: Array | None = None
        self.error = float("nan")

    def start(self, features: int, actions: int, matrix: npt.ArrayLike | None = None) -> None:
        """Forget everything.

        Args:
            features: F.
            actions: A.
            matrix: (F,A) what is known already; zeros without.

        Raises:
            ValueError: A matrix of another size, or not finite.
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
        """Learn from a change of features and the actions since: whether something was learnt.

        Args:
            delta_features: (F,).
            delta_action: (A,) the sum of the actions.
            measured: (F,) which features are learnt from; None for all.

        Nothing is learnt from changes that are not finite, nor without a motion.

        Raises:
            ValueError: ``start`` was not called, or a wrong size.
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
        """Forget what else is known; most know nothing else."""
        return

    @abstractmethod
    def _gain(self, da: Array) -> Array:
        """(A,) how the residual of a motion is shared out among the columns: ``J += (df - J da) gain'``."""


def check_in_range(name: str, value: float, most: float = 1.0) -> float:
    """A number above 0, at most ``most``.

    Raises:
        ValueError: It is none.
    """
    if not (isinstance(value, (int, float)) and not isinstance(value, bool) and 0 < value <= most):
        raise ValueError(f"{name}: expected a number above 0, at most {most:g}, got {value!r}.")
    assert math.isfinite(value)
    return float(value)


class Broyden(JacobianEstimator):
    """The smallest change of J that explains the last motion, taken in part: ``gain = g da / (da'da + e)``.

    Broyden, 'A class of methods for solving nonlinear simultaneous equations', Mathematics of Computation 1965, eq.
    4.5; damped as in Jagersand, Fuentes and Nelson, 'Experimental evaluation of uncalibrated visual servoing for
    precision manipulation', ICRA 1997.

    Args:
        gain: g, 0...1: less forgets noise, more follows bends.
        floor: e, what keeps small motions from teaching much.
    """

    def __init__(self, gain: float = 0.5, floor: float = 0.02) -> None:
        super().__init__()
        self.gain, self.floor = check_in_range("Broyden: gain", gain), check_in_range("Broyden: floor", floor, 1e6)

    def _gain(self, da: Array) -> Array:
        return self.gain * da / (da @ da + self.floor)


class Kalman(JacobianEstimator):
    """J as the state of a random walk that motions measure.

    ``P += q I``, ``gain = P da / (r + da'P da)``, ``P -= gain da'P``: all rows share one covariance P (A,A), since one
    motion measures all of them. Qian and Su, 'Online estimation of image Jacobian matrix by Kalman-Bucy filter for
    uncalibrated stereo vision feedback', ICRA 2002.

    Args:
        drift: q, how far J wanders between two updates, beside ``uncertainty``.
        noise: r, of a measured change.
        uncertainty: P at the start is this times the identity.
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
    """The J that explains all motions best, older ones less.

    ``gain = P da / (f + da'P da)``, then ``P = (P - gain da'P) / f``: Astrom and Wittenmark, 'Adaptive Control', 1995,
    section 2.2; for Jacobians Hosoda and Asada, 'Versatile visual servoing without knowledge of true Jacobian', IROS
    1994.

    Args:
        forgetting: f, 0...1: the weight of a motion sinks by this factor with each later one.
        uncertainty: P at the start is this times the identity. No eigenvalue of P grows beyond: directions in which
            nothing moves would else be believed less and less, until noise is taken for an answer.
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
        # One by one: scaling all of P would keep what moves from being forgotten while something else rests.
        self._covariance = (vectors * np.clip(values, 0.0, self.uncertainty)) @ vectors.T
        return gain


class PseudoJacobian(JacobianEstimator):
    """A projection: ``gain = eta da / (mu + da'da)``.

    Hou and Jin, 'Data-driven model-free adaptive control for a class of MIMO nonlinear discrete-time systems', IEEE
    Transactions on Neural Networks 2011, eq. 11 (compact form). It differs from ``Broyden`` in ``mu``, which is large:
    small motions teach little, and so does their noise. Theirs is reset where it leaves the cone that their proof of
    stability needs, which supposes a square matrix; here the law's guard does that, for any F and A.

    Args:
        eta: Step size, 0...1.
        mu: Penalty on change.
    """

    def __init__(self, eta: float = 0.5, mu: float = 0.2) -> None:
        super().__init__()
        self.eta, self.mu = check_in_range("PseudoJacobian: eta", eta), check_in_range("PseudoJacobian: mu", mu, 1e6)

    def _gain(self, da: Array) -> Array:
        return self.eta * da / (self.mu + da @ da)
