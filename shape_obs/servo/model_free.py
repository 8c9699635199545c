"""Model-free adaptive control's estimate of the pseudo-Jacobian."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shape_obs.servo.checks import share
from shape_obs.servo.estimator import JacobianEstimator

Array = npt.NDArray[np.float64]


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
        self.eta, self.mu = share("PseudoJacobian: eta", eta), share("PseudoJacobian: mu", mu, 1e6)

    def _gain(self, da: Array) -> Array:
        return self.eta * da / (self.mu + da @ da)
