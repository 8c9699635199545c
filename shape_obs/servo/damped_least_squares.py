"""The damped least-squares law on an estimated Jacobian."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shape_obs.servo.checks import share
from shape_obs.servo.estimator import JacobianEstimator
from shape_obs.servo.law import ServoLaw, saturated

Array = npt.NDArray[np.float64]


class DampedLeastSquares(ServoLaw):
    """``a = (J'WJ + m I)^-1 J'W g e``, shortened to the largest action: Levenberg's step towards the goal.

    Nakamura and Hanafusa, 'Inverse kinematic solutions with singularity robustness for robot manipulator control',
    Journal of Dynamic Systems, Measurement, and Control 1986. The damping m is a share of the mean diagonal of J'WJ, so
    that it means the same in any unit.

    Args:
        estimator: Of J.
        gain: g, 0...1: the share of the error to be removed by one step.
        damping: m, as a share: more takes directions that the features hardly answer to more slowly.
    """

    def __init__(self, estimator: JacobianEstimator, gain: float = 0.5, damping: float = 0.1) -> None:
        super().__init__(estimator)
        self.gain, self.damping = share("DampedLeastSquares: gain", gain), share("DampedLeastSquares: damping", damping)

    def _step(self, jacobian: Array, error: Array) -> Array:
        normal = jacobian.T @ jacobian
        normal += self.damping * np.trace(normal) / len(normal) * np.eye(len(normal))
        return saturated(np.linalg.solve(normal, jacobian.T @ (self.gain * error)))
