"""A colour rule as a table over all 256 x 256 x 256 colours, a bit each: the rule itself, not an approximation.

A table of 32 x 32 x 32 bins would fit the nearest cache, but a bin that the border of a rule cuts through turns whole
areas of one colour over, and drawn images have such areas. Two megabytes are looked up as fast: an object's colours lie
close together, so few of them are ever touched.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.image.segmentation import ColourRule

Table = npt.NDArray[np.uint64]

LEVELS: Final = 256
_KEPT: Final = 16  # tables, 2 MB each


@lru_cache(maxsize=_KEPT)
def colour_table(rule: ColourRule) -> Table:
    """Compile a rule, in some 40 ms; equal rules share one table.

    Returns:
        (262144,) uint64, read-only: the colour (r, g, b) is bit ``b & 63`` of word ``r << 10 | g << 2 | b >> 6``.

    Raises:
        ValueError: The rule gave something else than a mask of the image's size.
    """
    levels = np.arange(LEVELS, dtype=np.uint8)
    plane = np.empty((LEVELS, LEVELS, 3), np.uint8)
    plane[..., 1], plane[..., 2] = levels[:, None], levels
    table = np.empty((LEVELS, LEVELS * LEVELS // 8), np.uint8)
    for red in range(LEVELS):
        plane[..., 0] = red
        found = np.asarray(rule.matches(plane))
        if found.shape != (LEVELS, LEVELS):
            raise ValueError(
                f"segmentation {rule.kind!r}: matches() must give one value a pixel: expected shape "
                f"{(LEVELS, LEVELS)}, got {found.shape}."
            )
        table[red] = np.packbits(found.astype(bool), bitorder="little")
    words = table.reshape(-1).view("<u8").astype(np.uint64, copy=False)
    words.setflags(write=False)
    return words
