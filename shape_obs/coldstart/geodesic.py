"""The axis of a rope-like cloud at a cold start, by geodesic distance."""

from __future__ import annotations

from typing import Final

from shape_obs.cloud import Cloud
from shape_obs.form import Curve
from shape_obs.space.chain import chain

_MAX_BRIDGED: Final = 0.5


def geodesic_axis(cloud: Cloud) -> Curve:
    """The axis from tip to tip, in no particular direction, bridged where there are gaps."""
    found = chain(cloud.samples, cloud.links, [piece.samples for piece in cloud.components], cloud.width)
    doubt = found.doubt
    if not doubt and found.bridged.mean() > _MAX_BRIDGED:
        doubt = f"{found.bridged.mean():.0%} of the curve would be gaps (at most {_MAX_BRIDGED:.0%})"
    return Curve(found.points, found.bridged, doubt=doubt)
