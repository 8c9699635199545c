"""Coons patches: a surface through four sides.

References:
    S. A. Coons, "Surfaces for Computer-Aided Design of Space Forms", MIT, 1967.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def coons(sides: Array) -> Array:
    """The bilinearly blended patch of four sides.

    Args:
        sides: (4,S,D) clockwise: the top side from left to right, the right one downwards, the bottom one from right
            to left, the left one upwards; each ends where the next begins.

    Returns:
        (S,S,D) rows from top to bottom, the sides among them.
    """
    top, right, bottom, left = sides[0], sides[1], sides[2, ::-1], sides[3, ::-1]
    t = np.linspace(0, 1, sides.shape[1])
    u, v = t[None, :, None], t[:, None, None]
    across = (1 - u) * left[:, None] + u * right[:, None]
    down = (1 - v) * top[None] + v * bottom[None]
    corners = (1 - v) * ((1 - u) * top[0] + u * top[-1]) + v * ((1 - u) * bottom[0] + u * bottom[-1])
    return across + down - corners
