"""A segmented region: its window and mask, and what every shape of the segmentation shares."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.observed import Samples
from shape_obs.image.connected_runs import gather_cells, near_mask
from shape_obs.image.outline_tracing import SPECK, Traced, trace_components, trace_hole
from shape_obs.image.roi import Window

if TYPE_CHECKING:
    from shape_obs.geometry.outline import Outline

    cached_property = property  # a protocol's property accepts no other descriptor
else:
    from functools import cached_property

Array = npt.NDArray[np.float64]


class Component(NamedTuple):
    """One connected piece of a region.

    Args:
        area: Pixels.
        outline: ``(P, 2)`` pixels, image coordinates, closed, 8-connected, through the centres of the border pixels.
        holes: Length of the outlines of its holes, pixels; specks left out.
        width: Of the ribbon of this area and outline, pixels.
    """

    area: int
    outline: Array
    holes: float
    width: float


@dataclass(frozen=True)
class Region:
    """The pixels that a segmentation found; the ``Observed`` of an image.

    Args:
        window: Where ``mask`` lies in the image.
        mask: ``(h, w)`` uint8, C-contiguous, 0 = background, the plausible components alone.
        runs: ``(R, 3)`` its runs: row, first column, column past the last one, image coordinates.
        areas: Pixels of each component, largest first.
        box: The upright rectangle around them.
        area: Pixels of all components.
        pieces: How many components there are.
        refusal: Why it is no object, in words: nothing is seen, or noise, which is left out; empty if it may be one.
        resolution: One pixel.
        axis: Where its axis lies if it is a rope that was found among others; None if that is to be found.
        noise: Whether it was refused as noise.
    """

    window: Window
    mask: npt.NDArray[np.uint8]
    runs: npt.NDArray[np.int64]
    areas: tuple[int, ...]
    box: Window
    area: int
    pieces: int
    refusal: str = ""
    resolution: float = 1.0
    axis: FittedCurve | None = None
    noise: bool = False
    unit: ClassVar[str] = "px"
    noun: ClassVar[str] = "mask"
    sample_unit: ClassVar[str] = "pixels"
    dimension: ClassVar[int] = 2

    @cached_property
    def traced(self) -> Traced:
        """The outlines of all components, and the holes in them."""
        return Traced(*trace_components(self.mask, self.runs, self.pieces, self.window.left, self.window.top))

    @cached_property
    def _largest_first(self) -> npt.NDArray[np.intp]:
        return np.argsort(-self.traced.areas, kind="stable")

    @cached_property
    def components(self) -> tuple[Component, ...]:
        """The connected pieces, largest first."""
        return tuple(self._component(int(piece)) for piece in self._largest_first)

    def _component(self, piece: int) -> Component:
        outlines, stops, areas, widths, inner = self.traced
        first, stop, holes = (stops.item(piece - 1) if piece else 0), stops.item(piece), 0.0
        if len(inner):
            holes = float(inner[(inner[:, 0] == piece) & (inner[:, 3] >= SPECK), 4].sum())
        return Component(areas.item(piece), outlines[first:stop], holes, widths.item(piece))

    @cached_property
    def largest(self) -> Component:
        """The largest of the connected pieces."""
        return self._component(0 if self.pieces == 1 else int(self._largest_first[0]))

    @property
    def width(self) -> float:
        """Width of the largest component as a ribbon, pixels."""
        return self.largest.width

    @property
    def length(self) -> float:
        """Length of the ribbon of this area and width, pixels."""
        return self.area / self.width

    @cached_property
    def outline(self) -> Outline:
        """The outer outline of the largest component."""
        from shape_obs.geometry.outline import Outline  # a rope needs none

        return Outline(self.largest.outline)

    @property
    def outlined_share(self) -> float:
        """The share of the mask that the outline goes around: the largest component."""
        return self.areas[0] / max(self.area, 1)

    @cached_property
    def holes(self) -> npt.NDArray[np.int64]:
        """``(H, 2)`` column and row of the first border pixel of each hole of the largest component, largest first."""
        inner = self.traced.holes[self.traced.holes[:, 0] == self._largest_first[0]]
        return inner[np.argsort(-inner[:, 5], kind="stable"), 1:3].astype(np.int64)

    def traced_outline(self, hole: int | None) -> Outline:
        """Return the outer outline of the largest component, or of one of its holes, the largest first."""
        if hole is None:
            return self.outline
        if hole not in self._hole_outlines:
            from shape_obs.geometry.outline import Outline

            column, row = self.holes[hole].tolist()
            traced = trace_hole(self.mask, column, row, self.window.left, self.window.top)
            self._hole_outlines[hole] = Outline(traced, True)
        return self._hole_outlines[hole]

    @cached_property
    def _hole_outlines(self) -> dict[int, Outline]:
        return {}

    def outline_curve(self, hole: int | None = None) -> FittedCurve:
        """Return the outline without the staircase of pixels."""
        return self.traced_outline(hole).curve

    def outline_points(self, hole: int | None = None) -> Samples:
        """Return the points of the outline, each counting once."""
        points = self.traced_outline(hole).points
        return Samples(points, np.ones(len(points)), 1.0)

    def sheet_outline(self) -> tuple[Array, Array]:
        """Return the outline of the largest component as a sheet's: in the image and flat, which are the same."""
        return self.outline.smooth, self.outline.smooth

    def to_space(self, flat: Array) -> Array:
        """Return places on the flat sheet as they are."""
        return flat

    @property
    def cut_share(self) -> float:
        """The share of the outline that runs along the edge of the window."""
        (left, top, width, height), box = self.window, self.box
        inside = left < box.left and top < box.top
        if inside and box.left + box.width < left + width and box.top + box.height < top + height:
            return 0.0
        place = self.outline.traced - (left, top)
        return float(np.mean(np.any((place <= 0) | (place >= (width - 1, height - 1)), axis=1)))

    @property
    def parts(self) -> tuple[Region, ...]:
        """The region itself."""
        return (self,)

    @cached_property
    def pixels(self) -> npt.NDArray[np.int32]:
        """``(M, 2)`` pixels, window coordinates."""
        found = cv2.findNonZero(self.mask)  # OpenCV 4 returns (M, 1, 2), OpenCV 5 (M, 2), both None for an empty one
        return np.zeros((0, 2), np.int32) if found is None else np.asarray(found, dtype=np.int32).reshape(-1, 2)

    def gather(self, edge: float) -> Samples:
        """Return the pixels in cells of an edge, whole pixels."""
        return Samples(*gather_cells(self.runs, int(edge)), float(int(edge)))

    def all_samples(self) -> Samples:
        """Return every pixel, each counting once."""
        points = self.pixels + np.array([self.window.left, self.window.top], dtype=np.float64)
        return Samples(points, np.ones(len(points)), 1.0)

    def seen(self, points: Array, target: Array | None) -> Array:
        """Return ``(N, 2)`` pixels as they are."""
        return points

    def carries(self, points: Array) -> npt.NDArray[np.bool_]:
        """Return whether the mask has ``(N, 2)`` pixels, or a neighbour of theirs: ``(N,)`` bool."""
        points = np.ascontiguousarray(points, dtype=np.float64)
        return near_mask(self.mask, self.window.left, self.window.top, points, 1)

    def contains(self, points: Array) -> npt.NDArray[np.bool_]:
        """Return whether the mask has ``(N, 2)`` pixels: ``(N,)`` bool."""
        points = np.ascontiguousarray(points, dtype=np.float64)
        return near_mask(self.mask, self.window.left, self.window.top, points, 0)
