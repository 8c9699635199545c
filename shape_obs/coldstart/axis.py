"""The axis of a rope at a cold start: from a mask by folding and a skeleton graph, from a cloud by geodesics."""

from __future__ import annotations

from shape_obs.body import Body
from shape_obs.cloud import Cloud
from shape_obs.coldstart.geodesic import geodesic_axis
from shape_obs.coldstart.trace import trace
from shape_obs.deproject import SeenCloud
from shape_obs.form import Curve


def axis(body: Body) -> Curve:
    """The axis of a rope from tip to tip, in no particular direction."""
    if isinstance(body, SeenCloud):
        return body.lifted(axis(body.region))
    if isinstance(body, Cloud):
        return geodesic_axis(body)
    curve, bridged, doubt = trace(body)
    return Curve(curve, bridged, doubt=doubt)
