"""Recognise depth and clouds in a wrong unit by how far away, or how large, they put the object."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.frame import FARTHEST, MILLIMETRE
from shape_obs.image.region import Region

_NEAR, _FAR = 0.05, 20.0  # metres: an object lies nearer or farther only if the unit is wrong
_LEAST, _LARGEST = 0.005, 20.0  # metres: the same of the size of a cloud
_TRIES: Final = 30  # frames whose mask has no depth at all, after which it is looked at no more
_SOME: Final = 2000  # values whose median is taken
#: What the numbers of floating depth may be instead of metres, and what makes metres of them.
_FLOATING: Final = (
    ("millimetres", 1e-3, "give depth / 1000, or the camera's uint16 image as it is"),
    ("centimetres", 1e-2, "give depth / 100"),
    ("tenths of a millimetre", 1e-4, "give depth / 10000"),
    ("metres divided by 1000, as of millimetres that were converted twice", 1e3, "give depth * 1000"),
)
#: What the numbers of uint16 depth may be instead of millimetres, and what makes metres of them as they were read.
_WHOLE: Final = (
    ("tenths of a millimetre", 1e-1, "give depth // 10, or depth * 1e-4 as float32 metres"),
    ("centimetres", 1e1, "give depth * 10"),
    ("metres", 1e3, "give depth.astype(np.float32)"),
)


class UnitCheck:
    """Warn once if depth or a cloud puts the object where no object is.

    Only the first frame with depth under the mask is looked at, and the first one after each reset.

    Attributes:
        pending: Whether the next frame is to be looked at.
    """

    def __init__(self) -> None:
        self.pending, self._warned, self._tries = True, False, 0

    def reset(self) -> None:
        """Look at the next frame, unless there was a warning already."""
        self.pending, self._tries = not self._warned, 0

    def look_at_depth(self, regions: Iterable[Region], depth: npt.NDArray[Any]) -> None:
        """Warn if the depth under a mask is below 5 cm or above 20 m.

        Args:
            regions: The masks of one frame.
            depth: ``(H, W)`` as a frame holds it.
        """
        for region in regions:
            if not region.areas:
                continue
            rows, first, past = region.runs.T
            distance = middle_depth(depth[rows, (first + past) // 2])  # in the middle of each run of pixels
            if distance is not None:
                self.pending = False
                if problem := depth_problem(distance, depth.dtype):
                    self._warn(f"depth: the object is {distance:.3g} m away{problem}.", 5)
                return
            self._tries += 1
            self.pending = self._tries < _TRIES

    def look_at_cloud(self, points: npt.NDArray[np.floating[Any]]) -> None:
        """Warn if a cloud is smaller than 5 mm or larger than 20 m.

        Args:
            points: ``(M, 3)`` metres, finite.
        """
        if not len(points):
            return
        self.pending = False
        low, high = np.percentile(points[:: -(-len(points) // _SOME)], (5, 95), axis=0)
        size = float(np.max(high - low))
        if size > _LARGEST:
            text = f"cloud: the object is {size:.3g} m large. Are the points in millimetres? Give points / 1000."
            self._warn(text, 4)
        elif 0 < size < _LEAST:
            self._warn(
                f"cloud: the object is {size * 1e3:.3g} mm large. Were metres divided by 1000, as millimetres that "
                "are converted twice? Give points * 1000.",
                4,
            )

    def _warn(self, text: str, level: int) -> None:
        self._warned = True
        warnings.warn(f"{text} This warning is shown once.", stacklevel=level)


def middle_depth(values: npt.NDArray[Any]) -> float | None:
    """Return the median of depth values in metres; None if none is valid.

    Args:
        values: ``(M,)`` uint16 millimetres or floating metres; 0, negative, non-finite and absurd are invalid.
    """
    valid = values[(values > 0) & (values < FARTHEST)]
    if not len(valid):
        return None
    middle = float(np.median(valid[:: -(-len(valid) // _SOME)]))
    return middle * MILLIMETRE if values.dtype.kind == "u" else middle


def depth_problem(distance: float, dtype: np.dtype[Any]) -> str:
    """Return what is likely wrong with depth that puts an object at a distance; empty if it is plausible.

    Args:
        distance: In metres, as the depth was read.
        dtype: Of the depth: uint16 or floating.
    """
    if _NEAR <= distance <= _FAR:
        return ""
    whole = dtype.kind == "u"
    read = "uint16 depth is read as millimetres" if whole else "floating depth is read as metres"
    for unit, factor, advice in _WHOLE if whole else _FLOATING:
        if _NEAR <= distance * factor <= _FAR:
            return f": {read}, but these look like {unit}; {advice}"
    return f": {read}; check the unit"
