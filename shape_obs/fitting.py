"""One shape, one frame: from a region and the past to a curve and the present. Pure: the detector remembers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.clustering import som
from shape_obs.configurations import Configuration
from shape_obs.curve import arc_length, interpolate
from shape_obs.region import Region
from shape_obs.topology import Chain
from shape_obs.tracking import Track, advance, gate, orient, predict

Array = npt.NDArray[np.float64]

_MIN_PIXELS: Final = 16


@dataclass(frozen=True)
class Fit:
    """A curve found in a region.

    Args:
        curve: (P,2) pixels from end to end, in the order of the points; None when nothing was found.
        quality: 0...1.
        reason: Why it was refused; empty if it was not.
    """

    curve: Array | None
    quality: float = 0.0
    reason: str = ""

    @property
    def ok(self) -> bool:
        """Whether it passed the gate."""
        return not self.reason


def fit(
    region: Region, spec: Configuration, track: Track | None, anchor: Array | None, stamp: float
) -> tuple[Fit, Track | None]:
    """Find one shape: from the prediction while there is a track, else (or when that fails) from a cold start.

    Args:
        region: The mask.
        spec: What to look for.
        track: The past; None at the start. It orients a cold start too.
        anchor: (2,) pixel where point 0 belongs; None for the image's top-left.
        stamp: Seconds.

    Returns:
        The fit, and the track to remember (None when the fit was refused).
    """
    if not region.components:
        return Fit(None, reason="the mask is empty"), None
    if region.area < _MIN_PIXELS:
        return Fit(None, reason=f"the mask has {region.area} pixels, at least {_MIN_PIXELS} are needed"), None
    unfit = spec.unfit(region)
    if unfit:
        return Fit(None, reason=unfit), None
    if track is None:
        topology = spec.topology(region)
        start = _centres(spec.parameterise(region), topology.size)
        found = _numbered(_settle(start, topology, som.STATIC, region, spec, None), spec, anchor)
    else:
        topology = Chain(len(track.nodes))
        prediction = predict(track, stamp)
        found = _settle(prediction, topology, som.MOVING, region, spec, track)
        if not found.ok:
            start = orient(spec.symmetries(_centres(spec.parameterise(region), topology.size)), prediction)
            found = _settle(start, topology, som.STATIC, region, spec, None)
    if found.curve is None or not found.ok:
        return found, None
    nodes = _centres(found.curve, topology.size)
    present = advance(track, nodes, float(arc_length(found.curve)[-1]), stamp)
    return (_numbered(found, spec, anchor) if spec.order == "image" else found), present


def _settle(
    start: Array,
    topology: Chain,
    sigmas: tuple[float, ...],
    region: Region,
    spec: Configuration,
    track: Track | None,
) -> Fit:
    """Cluster, finish, judge."""
    nodes = som.fit(region.samples, start, topology, sigmas)
    curve = spec.finish(nodes, region)
    verdict = gate(curve, float(arc_length(curve)[-1]), region, track)
    return Fit(curve, verdict.quality, verdict.reason)


def _numbered(found: Fit, spec: Configuration, anchor: Array | None) -> Fit:
    """The fit so that point 0 lies at the end nearest the anchor, else nearest the image's top-left."""
    if found.curve is None:
        return found
    target = np.zeros(2) if anchor is None else anchor
    curve = min(spec.symmetries(found.curve), key=lambda c: float(np.sum((c[0] - target) ** 2)))
    return Fit(curve, found.quality, found.reason)


def _centres(curve: Array, count: int) -> Array:
    """(count,2) the centres of equal pieces of a curve."""
    arc = arc_length(curve)
    return interpolate(curve, arc, (np.arange(count) + 0.5) * (arc[-1] / count))
