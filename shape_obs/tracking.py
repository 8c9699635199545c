"""From frame to frame: what is remembered, where the shape will be, and whether what was found can be believed."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.kernels import numpy_ as kernels
from shape_obs.region import Region

Array = npt.NDArray[np.float64]

_VELOCITY_SHARE: Final = 0.8
_MAX_OFF_MASK: Final = 0.10
_MAX_SPREAD: Final = 0.40
_IDEAL_SPREAD: Final = 12**-0.5
_MAX_LENGTH_CHANGE: Final = 0.06


class Track(NamedTuple):
    """All the state there is of one shape.

    Args:
        nodes: (K,2) pixels, at the centres of equal pieces of the curve.
        velocity: (K,2) pixels a second.
        interval: Seconds over which the velocity was seen.
        length: Arc length of the curve, pixels.
        stamp: Seconds.
    """

    nodes: Array
    velocity: Array
    interval: float
    length: float
    stamp: float


class Verdict(NamedTuple):
    """What the gate says of a fit.

    Args:
        reason: Why it is refused; empty if it is not.
        quality: 0...1.
    """

    reason: str
    quality: float


def predict(track: Track, stamp: float) -> Array:
    """Where the nodes should be at ``stamp``: the last place plus most of the last step.  (K,2) pixels.

    Nothing is extrapolated farther than the last interval, so a shape that was lost is looked for near its last place.
    """
    ahead = min(max(stamp - track.stamp, 0.0), track.interval)
    return track.nodes + _VELOCITY_SHARE * ahead * track.velocity


def advance(track: Track | None, nodes: Array, length: float, stamp: float) -> Track:
    """The track after a frame in which the nodes were found."""
    interval = 0.0 if track is None else stamp - track.stamp
    velocity = np.zeros_like(nodes) if track is None or interval <= 0 else (nodes - track.nodes) / interval
    return Track(nodes, velocity, max(interval, 0.0), length, stamp)


def orient(candidates: tuple[Array, ...], prediction: Array) -> Array:
    """Of several numberings of the same (K,2) nodes, the one nearest to the prediction."""
    return min(candidates, key=lambda nodes: float(np.sum((nodes - prediction) ** 2)))


def gate(curve: Array, length: float, region: Region, track: Track | None) -> Verdict:
    """Judge a fit by its mask and by its past.

    Refused are a curve that leaves the mask over more than 10 % of its points; a mask that spreads about the curve
    more than a ribbon does (rms distance over width, 0.289 for an ideal ribbon, at most 0.40); and, against a track,
    a length that jumps by more than 6 %.

    Args:
        curve: (P,2) pixels.
        length: Its arc length, pixels.
        region: The mask.
        track: The past; None at a cold start.
    """
    off = 1.0 - float(region.contains(curve, reach=1).mean())
    spread = _spread(curve, region) / max(region.area / max(length, 1e-9), 1.0)
    excess = (spread - _IDEAL_SPREAD) / (_MAX_SPREAD - _IDEAL_SPREAD)
    quality = float(np.clip(1 - off / _MAX_OFF_MASK, 0, 1) * np.clip(1 - excess, 0, 1)) ** 0.5
    if off > _MAX_OFF_MASK:
        return Verdict(f"{off:.0%} of the curve lies off the mask (at most {_MAX_OFF_MASK:.0%})", 0.0)
    if spread > _MAX_SPREAD:
        return Verdict(
            f"the mask spreads {spread:.2f} widths about the curve (a ribbon {_IDEAL_SPREAD:.2f}, "
            f"at most {_MAX_SPREAD:.2f}): it is no single rope",
            0.0,
        )
    if track is not None and abs(length / track.length - 1) > _MAX_LENGTH_CHANGE:
        return Verdict(f"the length jumped from {track.length:.0f} to {length:.0f} px", 0.0)
    return Verdict("", quality)


def _spread(curve: Array, region: Region) -> float:
    """Root mean square distance of the mask's pixels from the curve, pixels."""
    samples = region.samples
    nearest = kernels.best_matching_units(samples.points, curve)
    tangent = np.gradient(curve, axis=0)
    reach = np.linalg.norm(tangent, axis=1)
    tangent /= np.maximum(reach, 1e-9)[:, None]
    offset = samples.points - curve[nearest]
    along = np.clip(np.einsum("md,md->m", offset, tangent[nearest]), -reach[nearest], reach[nearest])
    offset -= along[:, None] * tangent[nearest]
    within_cells = min(samples.scale, region.width) ** 2 / 12
    return float(np.sqrt(np.average(np.einsum("md,md->m", offset, offset), weights=samples.weight) + within_cells))
