"""A segmented region: its window and mask, and lazily what every shape of the segmentation shares.

From a frame to the region of a pixel rule, the quickest way that gives the same pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Final, TypeGuard

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.compiled import NUMPY, Kernels
from shape_obs.compiled.numpy_outline import outline_in
from shape_obs.frame import Frame
from shape_obs.geometry.outline import Border
from shape_obs.geometry.samples import Samples, mask_pixels
from shape_obs.image.colour_table import colour_table
from shape_obs.image.roi import ROI, Window
from shape_obs.image.segmentation import ColourRule, Segmentation, need

_MAX_CELL = 24


@dataclass(frozen=True)
class Component:
    """One connected piece of a region.

    Args:
        area: Pixels.
        outline: (P,2) pixels, image coordinates, closed, 8-connected, through the centres of the border pixels.
        perimeter: Length of the outline, pixels.
        holes: Length of the outlines of its holes, pixels; specks left out.
    """

    area: int
    outline: npt.NDArray[np.float64]
    perimeter: float
    holes: float

    @cached_property
    def width(self) -> float:
        """Width of the ribbon of this area and perimeter, pixels: the root of ``w (s - w) = area``.

        The outline of an L x w ribbon runs through pixel centres, so it is 2 (L - 1) + 2 (w - 1) long. A ribbon that
        lies in a loop has a part of it around the hole.
        """
        half = (self.perimeter + self.holes) / 2 + 2
        return max((half - max(half * half - 4 * self.area, 0.0) ** 0.5) / 2, 1.0)


@dataclass(frozen=True)
class Region:
    """The pixels that a segmentation found.

    Args:
        window: Where ``mask`` lies in the image.
        mask: (h,w) uint8, C-contiguous, 0 = background, the plausible components alone.
        runs: (R,3) row, first column, column past the last one of every row of pixels, image coordinates.
        areas: Pixels of each component, largest first.
        box: The upright rectangle around them.
        kernels: What runs the inner loops.
    """

    window: Window
    mask: npt.NDArray[np.uint8]
    runs: npt.NDArray[np.int64]
    areas: tuple[int, ...]
    box: Window
    kernels: Kernels = NUMPY
    unit: ClassVar[str] = "px"
    noun: ClassVar[str] = "mask"
    grains: ClassVar[str] = "pixels"
    grain: ClassVar[float] = 1.0
    thinnest: ClassVar[float] = 3.0

    @cached_property
    def amount(self) -> int:
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
            return (Component(self.amount, *self.kernels.traced(self.mask, self.runs, left, top, self.box)),)
        left, top = self.box.left - self.window.left, self.box.top - self.window.top
        crop = self.mask[top : top + self.box.height, left : left + self.box.width]
        count, found, table, _ = cv2.connectedComponentsWithStats(crop, connectivity=8)
        labels, stats = np.asarray(found, dtype=np.int32), np.asarray(table, dtype=np.int32)
        components = []
        for label in 1 + np.argsort(-stats[1:count, cv2.CC_STAT_AREA], kind="stable"):
            left, top, width, height, area = (int(value) for value in stats[label])
            piece = (labels[top : top + height, left : left + width] == label).view(np.uint8)
            components.append(Component(area, *outline_in(piece, self.box.left + left, self.box.top + top)))
        return tuple(components)

    def as_wide_as(self, width: float) -> Region:
        """The same region where its width is known, pixels: nothing has to be traced for it."""
        other = Region(self.window, self.mask, self.runs, self.areas, self.box, self.kernels)
        other.__dict__["width"] = width
        return other

    @cached_property
    def width(self) -> float:
        """Width of the largest component as a ribbon, pixels."""
        return self.components[0].width

    @cached_property
    def border(self) -> Border:
        """The outer outline of the largest component."""
        return Border(self.components[0].outline, kernels=self.kernels)

    @property
    def outlined(self) -> float:
        """The share of the mask that the outline goes around: the largest component."""
        return self.areas[0] / max(self.amount, 1)

    @cached_property
    def holes(self) -> tuple[Border, ...]:
        """The holes of the largest component, the largest first."""
        found, table = cv2.findContours(self.mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        contours = [contour.reshape(-1, 2) + (self.window.left, self.window.top) for contour in found]
        start = self.components[0].outline[0]
        parents = np.asarray(table).reshape(-1, 4)[:, 3]
        largest = next(i for i in np.flatnonzero(parents < 0) if np.any(np.all(contours[i] == start, axis=1)))
        inner = [contours[i] for i in np.flatnonzero(parents == largest)]
        inner.sort(key=cv2.contourArea, reverse=True)
        return tuple(Border(contour.astype(np.float64), True, self.kernels) for contour in inner)

    @cached_property
    def hollow(self) -> float:
        """The share of what the largest component's outline encloses that is not the component's."""
        enclosed = cv2.contourArea(self.border.traced.astype(np.float32)) + len(self.border.traced) / 2
        return 1 - float(np.max(self.areas)) / max(enclosed, 1.0)

    @cached_property
    def pixels(self) -> npt.NDArray[np.int32]:
        """(M,2) pixels, window coordinates."""
        return mask_pixels(self.mask)

    @cached_property
    def samples(self) -> Samples:
        """The pixels in cells of a third of the object's width: thin ropes keep their pixels, thick ones shed them."""
        return self.gathered(min(max(self.width / 3, 1), _MAX_CELL))

    def gathered(self, edge: float) -> Samples:
        """The pixels in cells of an edge, whole pixels."""
        return Samples(*self.kernels.cells(self.runs, int(edge)), float(int(edge)))

    @property
    def within(self) -> float:
        """Variance across a strand that the samples hide, square pixels."""
        return min(self.samples.scale, self.width) ** 2 / 12

    @property
    def stretch(self) -> float:
        """Length of the ribbon of this area and width, pixels."""
        return self.amount / self.width

    def breadth(self, length: float) -> float:
        """Width of a ribbon of this area and the given length, pixels."""
        return max(self.amount / max(length, 1e-9), 1.0)

    def seen(self, points: npt.NDArray[np.float64], target: npt.NDArray[np.float64] | None) -> npt.NDArray[np.float64]:
        """(N,2) pixels as they are."""
        return points

    def carries(self, points: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
        """Whether the mask carries (N,2) pixels, or a pixel beside them: (N,) bool."""
        return self.contains(points, reach=1)

    def contains(self, points: npt.NDArray[np.float64], reach: int = 0) -> npt.NDArray[np.bool_]:
        """Whether the mask carries (N,2) pixels, or any pixel at most ``reach`` away: (N,) bool."""
        return self.kernels.carried(self.mask, self.window.left, self.window.top, points, reach)


def find_region(
    mask: npt.NDArray[np.uint8], window: Window, min_area: int, min_share: float, kernels: Kernels = NUMPY
) -> Region:
    """Keep the plausible components of a mask.

    Args:
        mask: (h,w) uint8, 0 = background.
        window: Where the mask lies in the image.
        min_area: Smaller components are dropped, pixels.
        min_share: So are those smaller than this share of the largest.
        kernels: What runs the inner loops.

    Returns:
        The region; without components when nothing is left.
    """
    if not (mask.flags.c_contiguous and mask.flags.writeable):
        mask = mask.copy()  # one type for the kernels
    runs, areas, box, dropped = kernels.survey(mask, window.left, window.top, min_area, min_share)
    if dropped:
        mask = np.zeros_like(mask)
        for row, start, stop in (runs - [window.top, window.left, window.left]).tolist():
            mask[row, start:stop] = 255
    return Region(window, mask, runs, tuple(areas.tolist()), Window(*box), kernels)


# A strand at least so wide, pixels, is not missed where one pixel in step x step is looked at: see ``Kernels.seek``.
_STEPS: Final = ((12.0, 8), (7.0, 4))


def segment(frame: Frame, window: Window, rule: Segmentation, roi: ROI, kernels: Kernels, width: float = 0.0) -> Region:
    """Find the plausible components of a rule's mask in a window.

    A colour rule is looked up in its table where the kernels are fast at that. Where the object is known to be wide,
    not every pixel has to be read: components that hold no disc nearly as wide may then be overlooked, and all others
    are the same to the pixel.

    Args:
        frame: The images.
        window: Where to look.
        rule: Which pixels belong to the object.
        roi: What to blank in the window.
        kernels: What runs the inner loops.
        width: Of the object where it is thinnest, pixels; 0 where it is not known, and nothing is overlooked.
    """
    if not (kernels.reads_tables and _is_compiled(rule)):
        mask = rule.apply(frame, window)
    else:
        rgb, table = need(frame.rgb, "rgb", rule), colour_table(rule)
        step = next((step for least, step in _STEPS if width >= least), 1)
        untouched = max(rule.open, rule.close) <= 1 and type(roi).blank is ROI.blank
        if step > 1 and untouched:
            mask, runs, areas, box = kernels.seek(rgb, window, table, step, rule.min_area, rule.min_share)
            return Region(window, mask, runs, tuple(areas.tolist()), Window(*box), kernels)
        mask = rule.clean(kernels.table_mask(rgb, window, table))
    return find_region(roi.blank(mask, window), window, rule.min_area, rule.min_share, kernels)


def prepare(rule: Segmentation | None, kernels: Kernels) -> None:
    """Make now what the first frame would have to wait for."""
    if kernels.reads_tables and _is_compiled(rule):
        colour_table(rule)


def _is_compiled(rule: Segmentation | None) -> TypeGuard[ColourRule]:
    """Whether a rule is what its table says: a colour rule, and not one that changes what is made of the colours."""
    return (
        isinstance(rule, ColourRule)
        and type(rule).threshold is ColourRule.threshold
        and type(rule).apply is ColourRule.apply
        and type(rule).clean is ColourRule.clean
    )
