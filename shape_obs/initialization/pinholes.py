"""Holes inside a rope: what a reflection or noise leaves out of a mask, unlike the gap that strands enclose."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from shape_obs.image.find_region import find_region
from shape_obs.image.outline_tracing import SPECK
from shape_obs.image.region import Region
from shape_obs.initialization.skeleton import MOST_BRANCHES

_DEPTH: Final = 0.8  # widths from a hole to the border if it is filled: 0.5 in a strand, 0.7 in a crossing, 1 in a loop


def without_pinholes(region: Region) -> Region:
    """Fill the holes of a mask that lie within one rope, or within the crossing of two.

    Each of them would make the rope two thin strands side by side.

    Args:
        region: The mask of any number of ropes.

    Returns:
        The mask without them; the region itself if there are none.
    """
    traced = region.traced
    width = traced.widths[traced.holes[:, 0].astype(np.intp)]
    some = (traced.holes[:, 3] >= SPECK) & (traced.holes[:, 5] < np.pi * (_DEPTH * width) ** 2 + 1.0)
    if not some.any() or np.count_nonzero(some) > MOST_BRANCHES:
        return region
    mask, found = (region.mask > 0).view(np.uint8), False
    if mask.base is not None:
        mask = mask.copy()
    left, top = region.window[:2]
    for hole, across in zip(traced.holes[some], width[some], strict=True):
        column, row = int(hole[1]) - left + 1, int(hole[2]) - top
        if mask[row, column]:
            continue
        box = cv2.floodFill(mask, None, (column, row), (2.0,), flags=4)[3]
        margin = int(across) + 2
        area = np.s_[
            max(box[1] - margin, 0) : box[1] + box[3] + margin, max(box[0] - margin, 0) : box[0] + box[2] + margin
        ]
        near = mask[area]
        inside = near == 2
        depth = cv2.distanceTransform((near > 0).view(np.uint8), cv2.DIST_L2, 5)
        fills = float(np.asarray(depth)[inside].max()) <= _DEPTH * across
        near[inside] = 1 if fills else 0
        found |= fills
    return find_region(mask, region.window, 1, 0.0) if found else region
