"""The outline of a body as a closed curve, clockwise as seen: of a mask, or of a cloud along its z axis."""

from __future__ import annotations

import numpy as np

from shape_obs.compiled.interface_outline import CELL
from shape_obs.geometry.form import Curve
from shape_obs.geometry.outline import Border
from shape_obs.geometry.samples import Samples
from shape_obs.image.region import Region
from shape_obs.point_cloud.body import Body
from shape_obs.point_cloud.cloud import Cloud


def outline(body: Body, hole: int | None = None) -> Curve:
    """The outline of the largest piece.

    Args:
        body: A region or a cloud.
        hole: None for the outer outline; else which hole, the largest first; a cloud has none.
    """
    if isinstance(body, Cloud):
        points = body.outline()
        return Curve(points, np.zeros(len(points), bool), closed=True)
    return border(body, hole).curve


def outline_samples(body: Body, hole: int | None = None) -> Samples:
    """What that outline is made of, before any smoothing; weighed by arc length."""
    if isinstance(body, Cloud):
        curve = outline(body)
        step = np.diff(curve.arc)
        return Samples(curve.points, (step + np.roll(step, 1)) / 2, curve.size / len(curve.points))
    return border(body, hole).samples


def sampling(body: Body, hole: int | None = None) -> tuple[int, float]:
    """How many ``outline_samples`` there are, and how far apart they lie."""
    if isinstance(body, Cloud):
        samples = outline_samples(body)
        return len(samples), samples.scale
    return -(-len(border(body, hole).traced) // CELL), float(CELL)


def outline_points(body: Body, hole: int | None = None) -> Samples:
    """What that outline is made of, point by point, each counting once."""
    if isinstance(body, Cloud):
        curve = outline(body)
        count = len(curve.points)
        points, step = curve.at(np.arange(count) * (curve.size / count)), curve.size / count
    else:
        points, step = border(body, hole).points, 1.0
    return Samples(points, np.ones(len(points)), step)


def breadth(body: Body, hole: int | None = None) -> float:
    """How far apart the sides of the outline may come, in the body's unit.

    Known is the width of a region as a ribbon; a hole's, and a cloud's, which may be a ring's own axis, are not.
    """
    return body.width if isinstance(body, Region) and hole is None else np.inf


def holes(body: Body) -> int:
    """How many holes the largest piece has."""
    return len(body.holes) if isinstance(body, Region) else 0


def border(region: Region, hole: int | None) -> Border:
    """The border of a region's largest piece, or of one of its holes."""
    return region.border if hole is None else region.holes[hole]
