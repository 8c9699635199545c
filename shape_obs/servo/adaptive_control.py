"""The control law of model-free adaptive control."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shape_obs.servo.checks import share
from shape_obs.servo.estimator import JacobianEstimator
from shape_obs.servo.law import ServoLaw, saturated

Array = npt.NDArray[np.float64]


class ModelFreeAdaptiveControl(ServoLaw):
    """``a = r J'e / (l + |J|^2)``, shortened to the largest action: downhill, with no matrix to invert.

    Hou and Jin, 'Data-driven model-free adaptive control for a class of MIMO nonlinear discrete-time systems', IEEE
    Transactions on Neural Networks 2011, eq. 10. ``|J|`` is the spectral norm and ``l`` a share of its square.
    Directions that the features hardly answer to are taken slowly: safe, and slow where they matter.

    Args:
        estimator: Of J; the paper's is ``PseudoJacobian``.
        step: r, 0...2.
        penalty: l, on motion.
    """

    def __init__(self, estimator: JacobianEstimator, step: float = 1.0, penalty: float = 0.1) -> None:
        super().__init__(estimator)
        self.step = share("ModelFreeAdaptiveControl: step", step, 2.0)
        self.penalty = share("ModelFreeAdaptiveControl: penalty", penalty, 1e6)

    def _step(self, jacobian: Array, error: Array) -> Array:
        square = np.linalg.norm(jacobian, 2) ** 2
        return saturated(self.step * (jacobian.T @ error) / ((1 + self.penalty) * square))
