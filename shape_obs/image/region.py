"""A segmented region: its window and mask, and what every shape of the segmentation shares."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Final, TypeGuard

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.frame import Frame
from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.outline import Outline
from shape_obs.geometry.samples import Samples
from shape_obs.image.colour_search import find_by_colour, find_on_lattice, look_up, table_mask
from shape_obs.image.colour_table import colour_table
from shape_obs.image.connected_runs import find_components, gather_cells, near_mask
from shape_obs.image.outline_tracing import Component, follow_border, has_holes, trace_outline, trace_with_holes
from shape_obs.image.roi import ROI, Window
from shape_obs.image.rope_tip import extend_chain
from shape_obs.image.segmentation import ColourRule, Segmentation, need

Array = npt.NDArray[np.float64]

_MAX_CELL: Final = 24
# A strand at least so wide, pixels, is not missed where one pixel in step x step is looked at: see ``find_by_colour``.
_STEPS: Final = ((12.0, 8), (7.0, 4))


@dataclass(frozen=True)
class Region:
    """The pixels that a segmentation found; the ``Observed`` of an image.

    Args:
        window: Where ``mask`` lies in the image.
        mask: ``(h, w)`` uint8, C-contiguous, 0 = background, the plausible components alone.
        runs: ``(R, 3)`` its runs: row, first column, column past the last one, image coordinates.
        areas: Pixels of each component, largest first.
        box: The upright rectangle around them.
        known_width: Pixels, if the track remembers it: nothing has to be traced for it. 0 if it does not.
    """

    window: Window
    mask: npt.NDArray[np.uint8]
    runs: npt.NDArray[np.int64]
    areas: tuple[int, ...]
    box: Window
    known_width: float = 0.0
    unit: ClassVar[str] = "px"
    noun: ClassVar[str] = "mask"
    sample_unit: ClassVar[str] = "pixels"
    dimension: ClassVar[int] = 2
    resolution: ClassVar[float] = 1.0
    thinnest: ClassVar[float] = 3.0

    @cached_property
    def area(self) -> int:
        """Pixels."""
        return sum(self.areas)

    @property
    def pieces(self) -> int:
        """How many components there are."""
        return len(self.areas)

    @cached_property
    def components(self) -> tuple[Component, ...]:
        """The connected pieces, largest first."""
        if not self.areas:
            return ()
        if self.pieces == 1:
            left, top = self.window.left, self.window.top
            return (Component(self.area, *trace_outline(self.mask, self.runs, left, top, self.box)),)
        left, top = self.box.left - self.window.left, self.box.top - self.window.top
        crop = self.mask[top : top + self.box.height, left : left + self.box.width]
        count, found, table, _ = cv2.connectedComponentsWithStats(crop, connectivity=8)
        labels, stats = np.asarray(found, dtype=np.int32), np.asarray(table, dtype=np.int32)
        components = []
        for label in 1 + np.argsort(-stats[1:count, cv2.CC_STAT_AREA], kind="stable"):
            left, top, width, height, area = (int(value) for value in stats[label])
            piece = (labels[top : top + height, left : left + width] == label).view(np.uint8)
            components.append(Component(area, *trace_with_holes(piece, self.box.left + left, self.box.top + top)))
        return tuple(components)

    @cached_property
    def width(self) -> float:
        """Width of the largest component as a ribbon, pixels."""
        return self.known_width or self.components[0].width

    @property
    def length(self) -> float:
        """Length of the ribbon of this area and width, pixels."""
        return self.area / self.width

    @cached_property
    def outline(self) -> Outline:
        """The outer outline of the largest component."""
        return Outline(self.components[0].outline)

    @property
    def outlined_share(self) -> float:
        """The share of the mask that the outline goes around: the largest component."""
        return self.areas[0] / max(self.area, 1)

    @property
    def holes(self) -> int:
        """How many holes the largest component has."""
        return len(self.hole_outlines)

    @cached_property
    def hole_outlines(self) -> tuple[Outline, ...]:
        """The outlines of the holes of the largest component, the largest first."""
        found, table = cv2.findContours(self.mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        contours = [contour.reshape(-1, 2) + (self.window.left, self.window.top) for contour in found]
        start = self.components[0].outline[0]
        parents = np.asarray(table).reshape(-1, 4)[:, 3]
        largest = next(i for i in np.flatnonzero(parents < 0) if np.any(np.all(contours[i] == start, axis=1)))
        inner = [contours[i] for i in np.flatnonzero(parents == largest)]
        inner.sort(key=cv2.contourArea, reverse=True)
        return tuple(Outline(contour.astype(np.float64), True) for contour in inner)

    def traced_outline(self, hole: int | None) -> Outline:
        """Return the outer outline of the largest component, or of one of its holes, the largest first."""
        return self.outline if hole is None else self.hole_outlines[hole]

    def outline_curve(self, hole: int | None = None) -> FittedCurve:
        """Return the outline without the staircase of pixels."""
        return self.traced_outline(hole).curve

    def outline_samples(self, hole: int | None = None) -> Samples:
        """Return the points of the outline before any smoothing, two by two."""
        return self.traced_outline(hole).samples

    def outline_points(self, hole: int | None = None) -> Samples:
        """Return the points of the outline, each counting once."""
        points = self.traced_outline(hole).points
        return Samples(points, np.ones(len(points)), 1.0)

    def outline_width(self, hole: int | None = None) -> float:
        """Return how far apart the sides of the outline lie; infinite for a hole, where it is unknown."""
        return self.width if hole is None else np.inf

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
        """The observations that an initial axis is taken from: the region itself."""
        return (self,)

    @cached_property
    def hollow_share(self) -> float:
        """The share of what the largest component's outline encloses that is not the component's."""
        enclosed = cv2.contourArea(self.outline.traced.astype(np.float32)) + len(self.outline.traced) / 2
        return 1 - float(np.max(self.areas)) / max(enclosed, 1.0)

    @cached_property
    def pixels(self) -> npt.NDArray[np.int32]:
        """``(M, 2)`` pixels, window coordinates."""
        found = cv2.findNonZero(self.mask)  # OpenCV 4 returns (M, 1, 2), OpenCV 5 (M, 2), both None for an empty one
        return np.zeros((0, 2), np.int32) if found is None else np.asarray(found, dtype=np.int32).reshape(-1, 2)

    @cached_property
    def samples(self) -> Samples:
        """The pixels in cells of a third of the object's width; thin ropes keep their pixels."""
        return self.gather(min(max(self.width / 3, 1), _MAX_CELL))

    def gather(self, edge: float) -> Samples:
        """Return the pixels in cells of an edge, whole pixels."""
        return Samples(*gather_cells(self.runs, int(edge)), float(int(edge)))

    def all_samples(self) -> Samples:
        """Return every pixel, each counting once."""
        points = self.pixels + np.array([self.window.left, self.window.top], dtype=np.float64)
        return Samples(points, np.ones(len(points)), 1.0)

    @property
    def hidden_variance(self) -> float:
        """Variance across a strand that the samples hide, square pixels."""
        return min(self.samples.scale, self.width) ** 2 / 12

    def with_width(self, width: float) -> Region:
        """Return the same region with a width known from the past, pixels; 0 if it is unknown."""
        return replace(self, known_width=width) if width else self

    def ribbon_width(self, length: float) -> float:
        """Return the width of a ribbon of this area and a length, pixels."""
        return max(self.area / max(length, 1e-9), 1.0)

    def pixels_of(self, points: Array) -> Array:
        """Return ``(N, 2)`` pixels as they are."""
        return points

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

    def extend_to_tips(self, nodes: Array) -> Array:
        """Cut a chain of nodes ``(K, 2)`` where it hangs over the mask, and lengthen it to the rope's tips."""
        return extend_chain(nodes, self.mask, self.window.left, self.window.top, self.width, self.thinnest)


def segment(frame: Frame, window: Window, rule: Segmentation, roi: ROI, width: float = 0.0) -> Region:
    """Find the plausible components of a rule's mask in a window, the quickest way that gives the same pixels.

    A colour rule is looked up in its table. If the object is known to be wide, not every pixel has to be read:
    components that hold no disc nearly as wide may then be overlooked, and all others are the same to the pixel.

    Args:
        frame: The images.
        window: Where to look.
        rule: Which pixels belong to the object.
        roi: What to blank in the window.
        width: Of the object where it is thinnest, pixels; 0 if it is unknown, and nothing is overlooked.
    """
    if not is_tabulated(rule):
        mask = rule.apply(frame, window)
    else:
        rgb, table = need(frame.rgb, "rgb", rule), colour_table(rule)
        step = next((step for least, step in _STEPS if width >= least), 1)
        untouched = max(rule.open, rule.close) <= 1 and type(roi).blank is ROI.blank
        if step > 1 and untouched:
            mask, runs, areas, box = find_by_colour(rgb, window, table, step, rule.min_area, rule.min_share)
            return Region(window, mask, runs, tuple(areas.tolist()), Window(*box))
        mask = rule.clean(table_mask(rgb, window, table))
    return find_region(roi.blank(mask, window), window, rule.min_area, rule.min_share)


def find_region(mask: npt.NDArray[np.uint8], window: Window, min_area: int, min_share: float) -> Region:
    """Keep the plausible components of a mask.

    Args:
        mask: ``(h, w)`` uint8, 0 = background.
        window: Where the mask lies in the image.
        min_area: Smaller components are dropped, pixels.
        min_share: So are those smaller than this share of the largest.

    Returns:
        The region; without components when nothing is left.
    """
    if mask.dtype != np.uint8:
        mask = (mask != 0).view(np.uint8)
    if not (mask.flags.c_contiguous and mask.flags.writeable):
        mask = mask.copy()  # compiled code distinguishes such arrays
    runs, areas, box, dropped = find_components(mask, window.left, window.top, min_area, min_share)
    if dropped:
        mask = np.zeros_like(mask)
        for row, start, stop in (runs - [window.top, window.left, window.left]).tolist():
            mask[row, start:stop] = 255
    return Region(window, mask, runs, tuple(areas.tolist()), Window(*box))


def is_tabulated(rule: Segmentation | None) -> TypeGuard[ColourRule]:
    """Return whether a table gives what a rule gives: a colour rule that overrides nothing but ``matches``."""
    return (
        isinstance(rule, ColourRule)
        and type(rule).threshold is ColourRule.threshold
        and type(rule).apply is ColourRule.apply
        and type(rule).clean is ColourRule.clean
    )


def prepare(rules: Iterable[Segmentation | None]) -> list[Callable[..., Any]]:
    """Build the tables of colour rules, and return the compiled functions that any region needs."""
    tabulated = [colour_table(rule) for rule in rules if is_tabulated(rule)]
    colours = [look_up, find_on_lattice] if tabulated else []
    return [find_components, near_mask, follow_border, has_holes, *colours]
