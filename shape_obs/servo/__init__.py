"""Shape servoing: from an error of features to a robot's action, on a Jacobian that is learnt on the way."""

from shape_obs.servo.adaptive_control import ModelFreeAdaptiveControl
from shape_obs.servo.broyden import Broyden
from shape_obs.servo.damped_least_squares import DampedLeastSquares
from shape_obs.servo.estimator import JacobianEstimator
from shape_obs.servo.excitation import Excitation
from shape_obs.servo.kalman import Kalman
from shape_obs.servo.law import ServoLaw
from shape_obs.servo.laws import LAWS, make_law
from shape_obs.servo.model_free import PseudoJacobian
from shape_obs.servo.recursive_least_squares import RecursiveLeastSquares
from shape_obs.servo.shape_servo import ShapeServo
from shape_obs.servo.weights import geometric_weights

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
