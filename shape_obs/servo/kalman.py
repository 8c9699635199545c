"""A Kalman filter over the Jacobian."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shape_obs.servo.checks import share
from shape_obs.servo.estimator import JacobianEstimator

Array = npt.NDArray[np.float64]


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
        self.drift = share("Kalman: drift", drift, 1e6)
        self.noise = share("Kalman: noise", noise, 1e6)
        self.uncertainty = share("Kalman: uncertainty", uncertainty, 1e6)

    def _begin(self, actions: int) -> None:
        self._covariance = self.uncertainty * np.eye(actions)

    def _gain(self, da: Array) -> Array:
        before = self._covariance + self.drift * np.eye(len(da))
        spread = before @ da
        gain = spread / (self.noise + da @ spread)
        after = before - np.outer(gain, spread)
        self._covariance = (after + after.T) / 2
        return gain
