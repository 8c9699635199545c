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
        uncertainty: P at the start is this times the identity. P grows no further: directions in which nothing moves
            would else be believed less and less, until noise is taken for an answer.
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
        after = (before - np.outer(gain, spread)) / self.forgetting
        largest = np.linalg.eigvalsh(after)[-1]
        self._covariance = after * min(1.0, self.uncertainty / largest)
        return gain
