"""Notice lengths and places that are in another unit than metres."""

from __future__ import annotations

import warnings
from typing import Final

import numpy as np
import numpy.typing as npt

#: Metres: nothing in a robot's cell, and no pose there, is farther or longer.
MOST: Final = 20.0
_UNITS: Final = (("millimetres", 1e-3), ("centimetres", 1e-2))


def warn_unless_metres(
    what: str, lengths: npt.ArrayLike, most: float = MOST, least: float = 0.0, stacklevel: int = 3
) -> None:
    """Warn if the largest of some lengths or coordinates is not plausible in metres, and name the likely unit.

    Args:
        what: What they are, the start of the warning.
        lengths: Lengths or coordinates, as metres.
        most: The largest plausible one, in metres.
        least: The smallest plausible value of the largest one, in metres.
        stacklevel: As for ``warnings.warn``, counted from here.
    """
    largest = float(np.max(np.abs(np.asarray(lengths, np.float64)), initial=0.0))
    if largest > most:
        likely = [f"{name} ({factor * largest:.3g} m)" for name, factor in _UNITS if factor * largest <= most]
        hint = f"are these {' or '.join(likely)}? Give metres" if likely else "check the unit"
        warnings.warn(f"{what}: {largest:.4g} m is too far for metres: {hint}.", stacklevel=stacklevel)
    elif 0 < largest < least:
        warnings.warn(
            f"{what}: {largest:.3g} m is too small for metres: were these divided by 1000 twice? Give metres.",
            stacklevel=stacklevel,
        )
