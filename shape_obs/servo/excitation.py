"""Small motions at the start, by which a Jacobian is first learnt."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shape_obs.spec import Spec, SpecError

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Excitation(Spec):
    """Each coordinate by itself there and back, so that the robot ends where it began.

    Args:
        amplitude: Of the largest action, above 0, at most 1.
        hold: Steps there, and as many back: more where the object follows slowly.
    """

    amplitude: float = 0.6
    hold: int = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.amplitude <= 1 or self.hold < 1:
            raise SpecError(
                f"excitation: expected an amplitude above 0, at most 1, and hold of 1 step or more, got {self}."
            )

    def actions(self, size: int) -> Array:
        """(2 size hold, size) one after the other."""
        there_and_back = np.repeat([self.amplitude, -self.amplitude], self.hold)
        return np.kron(np.eye(size), there_and_back[:, None]).astype(np.float64)
