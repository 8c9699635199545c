"""Memory of a lost rope: in which order its nodes are when it is found again."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.polyline import resample
from shape_obs.geometry.rotation import spread_of
from shape_obs.initialization.objects import COMPARED
from shape_obs.tracking.predict import Track

Array = npt.NDArray[np.float64]

# ``python -m tests.benchmarks record.order``: ropes that move and bend, by up to 1 m/s, while they are out of sight.
_FREE: Final = 14.0  # coordinates of a form that change independently: at 3 to 5 nats, 1 decision in 20 is wrong
_MOVES: Final = 0.05  # of the length, RMS: how far nodes move at once, and in the first second
_LASTS: Final = 0.1  # seconds in which a rope that moves unseen forgets its velocity, twice


def evidence_of_order(lost: Track, nodes: Array, seconds: float) -> float:
    """Return by how many nats the nodes of a rope that was lost are likelier in their order than reversed.

    Of an order of the nodes that lie d from those remembered, RMS and relative to the length, once both are moved to
    one middle, minus the log likelihood is m/2 log(s^2 + d^2): m coordinates have changed by an amount that is not
    known, but which is s at least (Student's t). In t seconds s^2 has grown from s0^2 to s0^2 (1 + t) + v^2 tau t, of
    which the second is the spread of nodes that had the velocity v and forget it (Uhlenbeck and Ornstein, "On the
    Theory of the Brownian Motion", 1930).

    Args:
        lost: The rope's track.
        nodes: ``(K, D)`` where it was found, in either order, in the unit of the track.
        seconds: Since the track saw it.
    """
    form, known = resample(nodes, COMPARED), resample(lost.nodes, COMPARED)  # (P, D)
    square = max(lost.size, 1e-9) ** 2
    spread = _MOVES**2 * (1 + seconds) + _LASTS * seconds * spread_of(lost.velocity) / square
    own, reverse = (np.log(spread + spread_of(way - known) / square) for way in (form, form[::-1]))
    return _FREE / 2 * float(reverse - own)
