"""Shape servoing: from an error of features to a robot's action, on a Jacobian that is learnt on the way."""

from shape_obs.servo.control_law import (
    LAWS,
    DampedLeastSquares,
    ModelFreeAdaptiveControl,
    ServoLaw,
    geometric_weights,
    make_law,
)
from shape_obs.servo.jacobian import Broyden, JacobianEstimator, Kalman, PseudoJacobian, RecursiveLeastSquares
from shape_obs.servo.shape_servo import Excitation, ShapeServo

__all__ = [
    "LAWS",
    "Broyden",
    "DampedLeastSquares",
    "Excitation",
    "JacobianEstimator",
    "Kalman",
    "ModelFreeAdaptiveControl",
    "PseudoJacobian",
    "RecursiveLeastSquares",
    "ServoLaw",
    "ShapeServo",
    "geometric_weights",
    "make_law",
]
