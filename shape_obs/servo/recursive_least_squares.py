"""Recursive least squares with forgetting."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shape_obs.servo.checks import share
from shape_obs.servo.estimator import JacobianEstimator

Array = npt.NDArray[np.float64]


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
        self.forgetting = share("RecursiveLeastSquares: forgetting", forgetting)
        self.uncertainty = share("RecursiveLeastSquares: uncertainty", uncertainty, 1e6)

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
