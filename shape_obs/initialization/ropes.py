"""Every rope of a mask: strands joined over gaps where that is unambiguous, and why each one may be wrong."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.curve import FittedCurve
from shape_obs.image.region import Region
from shape_obs.initialization.medial_axis import Strand, find_strands
from shape_obs.initialization.objects import SceneObject

Array = npt.NDArray[np.float64]

# In widths: a shorter strand with an end on another one is a knob or noise, and a shorter one is no rope at all.
_STUB: Final = 4.0
_SHORTEST: Final = 3.0


def find_ropes(region: Region) -> tuple[list[SceneObject], str]:
    """Return the ropes of a mask, longest first, and why there are none.

    Args:
        region: The mask of any number of ropes that may lie over each other.
    """
    strands, refusal = find_strands(region)
    ropes = [_rope(strand) for strand in strands if not _is_stub(strand)]
    return sorted(ropes, key=lambda rope: -rope.curve.size), refusal


def _is_stub(strand: Strand) -> bool:
    return strand.length < (_STUB if any(strand.inside) else _SHORTEST) * strand.width


def _rope(strand: Strand) -> SceneObject:
    doubts = list(strand.doubts)
    if strand.closed:
        doubts.append("it is a closed ring: where it begins is unknown")
    axis = FittedCurve.through(strand.curve, np.zeros(len(strand.curve), bool), ambiguity="; ".join(doubts))
    return SceneObject(axis, strand.width)
