"""The whole image."""

from __future__ import annotations

from dataclasses import dataclass

from shape_obs.roi.base import ROI, Window


@dataclass(frozen=True)
class Whole(ROI, kind="whole"):
    """The whole image."""

    def window(self, size: tuple[int, int]) -> Window:
        """The whole image."""
        return Window(0, 0, size[1], size[0])
