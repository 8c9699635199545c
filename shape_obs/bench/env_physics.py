"""Whether the simulated objects behave: states stay finite, the engine does not complain, nothing stretches."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Strain(NamedTuple):
    """How much longer an object is than at rest; 0.05 is five hundredths.

    Args:
        whole: Of its length from end to end or once around; of a sheet, the same as ``local``.
        local: Of the piece between two neighbouring joints or masses that is stretched most.
    """

    whole: float
    local: float


def is_finite(simulator: Any) -> bool:
    """Whether the whole physics state is."""
    return bool(np.isfinite(simulator.get_state()).all())


def warnings(simulator: Any) -> int:
    """How often MuJoCo has warned since the object was last put down."""
    return int(np.sum(simulator._body.data.warning.number))


def strain(simulator: Any) -> Strain:
    """Of a rope's or band's middle line, or of the edges between a sheet's masses."""
    body, kind = simulator._body, simulator.goal_layout["kind"]
    if kind == "surface":
        return Strain(body.stretch(), body.stretch())
    if kind == "contour":
        line = body.axis()
        return _of_pieces(np.concatenate([line, line[:1]]), np.full(len(line), body.spec.link_length))
    line, spec = body.vertices(), body.spec
    rest = np.full(len(line) - 1, spec.link_length)
    rest[[0, -1]] += spec.radius
    return _of_pieces(line, rest)


def _of_pieces(line: Array, rest: Array) -> Strain:
    pieces = np.linalg.norm(np.diff(line, axis=0), axis=1)
    return Strain(float(pieces.sum() / rest.sum() - 1), float((pieces / rest).max() - 1))
