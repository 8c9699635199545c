"""The objects of a mask that holds several: where each lies, before it is known which one it is."""

from __future__ import annotations

from typing import Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.geometry.curve import FittedCurve
from shape_obs.image.find_region import find_region
from shape_obs.image.region import Region

Array = npt.NDArray[np.float64]

SHORTEST_ROPE: Final = 3.0  # widths: what is shorter is no rope, see ``Centerline``
COMPARED: Final = 64  # points of a curve or an outline that are compared with a track


class SceneObject(NamedTuple):
    """One object of a mask.

    Args:
        curve: Its axis or its outline; why it may be wrong is its ``ambiguity``.
        width: Of its ribbon, pixels; 0 for an object with an outline.
        region: The part of the mask that is its own; None if it shares pixels with others.
    """

    curve: FittedCurve
    width: float = 0.0
    region: Region | None = None

    @property
    def starts(self) -> Array:
        """``(S, 2)`` where point 0 may be: at either tip, or anywhere around an outline."""
        points = self.curve.points
        return points if self.curve.closed else points[[0, -1]]


def find_components(region: Region) -> tuple[list[SceneObject], str]:
    """Return each connected piece of a mask as an object, largest first, and why there is none."""
    labels = cv2.connectedComponents(region.mask)[1]
    left, top = region.window[:2]
    found = []
    for component in region.components:
        column, row = component.outline[0].astype(int) - (left, top)
        own = np.ascontiguousarray(labels == labels[row, column]).view(np.uint8)
        part = find_region(own, region.window, 1, 0.0)
        outline = FittedCurve.through(component.outline, np.zeros(len(component.outline), bool), True)
        points = FittedCurve.through(outline.even(COMPARED), np.zeros(COMPARED, bool), True)
        found.append(SceneObject(points, region=part))
    return found, "" if found else "the mask is empty"
