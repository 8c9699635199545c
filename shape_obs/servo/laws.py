"""The laws by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from shape_obs.servo.adaptive_control import ModelFreeAdaptiveControl
from shape_obs.servo.broyden import Broyden
from shape_obs.servo.damped_least_squares import DampedLeastSquares
from shape_obs.servo.kalman import Kalman
from shape_obs.servo.law import ServoLaw
from shape_obs.servo.model_free import PseudoJacobian
from shape_obs.servo.recursive_least_squares import RecursiveLeastSquares
from shape_obs.spec import did_you_mean

_MADE: Final[Mapping[str, tuple[str, Callable[[], ServoLaw]]]] = {
    "broyden": ("Broyden's update, damped least squares", lambda: DampedLeastSquares(Broyden())),
    "rls": ("recursive least squares, damped least squares", lambda: DampedLeastSquares(RecursiveLeastSquares())),
    "kalman": ("Kalman filter, damped least squares", lambda: DampedLeastSquares(Kalman())),
    "mfac": ("pseudo-Jacobian, damped least squares", lambda: DampedLeastSquares(PseudoJacobian())),
    "mfac-law": ("pseudo-Jacobian, model-free adaptive control", lambda: ModelFreeAdaptiveControl(PseudoJacobian())),
}
#: What each name stands for: an estimator, and the law that acts on its Jacobian.
LAWS: Final[Mapping[str, str]] = {name: what for name, (what, _) in _MADE.items()}


def make_law(name: str) -> ServoLaw:
    """A law with the settings that stood the bench best.

    Raises:
        ValueError: An unknown name.
    """
    if name not in _MADE:
        raise ValueError(f"servo law: unknown name {name!r}{did_you_mean(name, LAWS)}")
    return _MADE[name][1]()
