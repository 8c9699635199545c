"""Broyden's rank-one update."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shape_obs.servo.checks import share
from shape_obs.servo.estimator import JacobianEstimator

Array = npt.NDArray[np.float64]


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
        self.gain, self.floor = share("Broyden: gain", gain), share("Broyden: floor", floor, 1e6)

    def _gain(self, da: Array) -> Array:
        return self.gain * da / (da @ da + self.floor)
