"""The gate: whether what was found can be believed, how far, and in words why not."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.body import Body
from shape_obs.form import Curve
from shape_obs.kernels import numpy_ as kernels

Array = npt.NDArray[np.float64]

_MAX_OFF: Final = 0.10
_MAX_SPREAD: Final = 0.40
_IDEAL_SPREAD: Final = 12**-0.5
MAX_HIDDEN: Final = 0.5  # of a tracked shape


class Verdict(NamedTuple):
    """What the gate says of a fit.

    Args:
        reason: Why it is refused; empty if it is not.
        quality: 0...1.
    """

    reason: str
    quality: float


def judge_ribbon(curve: Curve, body: Body, bridged: float) -> Verdict:
    """Judge the axis of a ribbon or a rope.

    Refused are a curve that leaves the body over 10 % more than ``bridged`` explains, and a body that spreads about
    the curve more than a ribbon does (rms distance over width, 0.289 for an ideal ribbon, at most 0.40).

    Args:
        curve: From end to end; bridged is what lies off the body.
        body: What it was fitted to.
        bridged: The share of the curve that is known to be bridged or hidden.
    """
    empty = float(curve.bridged.mean())
    hidden = min(empty, bridged)
    off = empty - hidden
    if off > _MAX_OFF:
        return Verdict(f"{off:.0%} of the curve lies off the {body.noun} (at most {_MAX_OFF:.0%})", 0.0)
    spread = _spread(curve.points, body) / max(body.breadth(curve.size * (1 - hidden)), 1e-9)
    if spread > _MAX_SPREAD:
        return Verdict(
            f"the {body.noun} spreads {spread:.2f} widths about the curve (a ribbon {_IDEAL_SPREAD:.2f}, "
            f"at most {_MAX_SPREAD:.2f}): it is no single rope",
            0.0,
        )
    excess = (spread - _IDEAL_SPREAD) / (_MAX_SPREAD - _IDEAL_SPREAD)
    return Verdict("", float(np.clip(1 - off / _MAX_OFF, 0, 1) * np.clip(1 - excess, 0, 1)) ** 0.5)


def _spread(curve: Array, body: Body) -> float:
    """Root mean square distance of the body's samples from the curve, in the body's unit."""
    samples = body.samples
    nearest = kernels.best_matching_units(samples.points, curve)
    tangent = np.gradient(curve, axis=0)
    reach = np.linalg.norm(tangent, axis=1)
    tangent /= np.maximum(reach, 1e-9)[:, None]
    offset = samples.points - curve[nearest]
    along = np.clip(np.einsum("md,md->m", offset, tangent[nearest]), -reach[nearest], reach[nearest])
    offset -= along[:, None] * tangent[nearest]
    within_cells = min(samples.scale, body.width) ** 2 / 12
    return float(np.sqrt(np.average(np.einsum("md,md->m", offset, offset), weights=samples.weight) + within_cells))
