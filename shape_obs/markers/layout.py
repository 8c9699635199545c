"""The positions of markers on a table, in metres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from shape_obs.markers.finder import DICTIONARY, check_ids
from shape_obs.spec import Spec, SpecError

Corner = tuple[float, float]
Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class MarkerLayout(Spec):
    """Markers on a flat table.

    Args:
        ids: The ids of the markers.
        corners: The four corners (x, y) of each marker in metres on the table: its own top left, top right, bottom
            right and bottom left. ``MarkerLayout.rectangle`` computes them for the usual case.
        dictionary: The marker dictionary, see ``find_markers``.
    """

    ids: tuple[int, ...]
    corners: tuple[tuple[Corner, Corner, Corner, Corner], ...]
    dictionary: str = DICTIONARY

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ids(self.ids, self.dictionary)
        if len(self.corners) != len(self.ids) or not self.ids:
            raise SpecError(
                f"MarkerLayout: expected four corners for each of the markers {list(self.ids)}, "
                f"got those of {len(self.corners)}."
            )
        if not np.all(np.isfinite(self.array)):
            raise SpecError("MarkerLayout: corners must be finite numbers of metres.")

    @classmethod
    def rectangle(
        cls,
        marker: float,
        width: float,
        height: float,
        ids: tuple[int, int, int, int] = (0, 1, 2, 3),
        dictionary: str = DICTIONARY,
    ) -> MarkerLayout:
        """Return the layout of four equal upright markers in the corners of a rectangle, aligned with its sides.

        The origin is the upper left corner of the first marker, x runs along the upper side and y down, so z points
        into the table.

        Args:
            marker: Side of a marker's black square in metres.
            width: Width of the rectangle in metres, between the outer edges of the left and the right markers.
            height: Height of the rectangle in metres, between the outer edges of the upper and the lower markers.
            ids: Top left, top right, bottom right, bottom left.
            dictionary: The marker dictionary.

        Raises:
            SpecError: A size is not positive, or the rectangle is too small for its markers.
        """
        if not (0 < marker < np.inf and 2 * marker <= width < np.inf and 2 * marker <= height < np.inf):
            raise SpecError(
                f"MarkerLayout: expected a rectangle of at least two markers' width and height, "
                f"got markers of {marker} m in {width} x {height} m."
            )
        square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * marker
        places = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * (width - marker, height - marker)
        corners: Any = (places[:, None] + square).tolist()
        return cls(ids, corners, dictionary)

    @property
    def array(self) -> Array:
        """The corners as an array ``(M, 4, 2)``."""
        return np.array(self.corners, np.float64)

    @property
    def box(self) -> tuple[Corner, Corner]:
        """The smallest and the largest (x, y) of all corners in metres."""
        every = self.array.reshape(-1, 2)
        low, high = every.min(axis=0).tolist(), every.max(axis=0).tolist()
        return (low[0], low[1]), (high[0], high[1])
