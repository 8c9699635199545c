"""An upright rectangle of pixels."""

from __future__ import annotations

from dataclasses import dataclass

from shape_obs.roi.base import ROI, Window, clipped


@dataclass(frozen=True)
class Rectangle(ROI, kind="rectangle"):
    """An upright rectangle.

    Args:
        left: First column, pixels.
        top: First row, pixels.
        width: Columns.
        height: Rows.
    """

    left: int
    top: int
    width: int
    height: int

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.width < 1 or self.height < 1:
            raise ValueError(f"Rectangle: width and height must be positive, got {self.width} x {self.height}.")

    def window(self, size: tuple[int, int]) -> Window:
        """The part of the rectangle that lies in the image."""
        box = (self.left, self.top, self.left + self.width, self.top + self.height)
        return clipped(box, size, self)
