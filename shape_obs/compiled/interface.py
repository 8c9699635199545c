"""What a backend offers. Both have the same functions, and agree to 1e-3 px."""

from __future__ import annotations

from typing import Any, Final, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from shape_obs.compiled.interface_outline import OutlineKernels, SheetKernels
from shape_obs.image.roi import Window

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.uint8]

MILLIMETRE: Final = 1e-3  # metres; the unit of depth in whole numbers
FARTHEST: Final = 1e6  # metres; what lies beyond is garbage, and would overflow single precision
FAR_OFF: Final = 2.0**30  # pixels; no image reaches there, and integers hold it
# An empty bin pulls its node nowhere: each node keeps a trace of weight where it stands.
TRACE: Final = 1e-3
# Chords are equalised this often, or until their gaps differ by no more than this share.
EQUALISING_PASSES: Final = 40
EQUAL: Final = 2e-3
# A folded outline: places around it, along its sides, and of those the ones by which tips are chosen; bends that are
# tried as tips.
OUTLINE_POINTS: Final = 256
SIDE_POINTS: Final = 96
SIDE_PROBES: Final = 32
SHARP_BENDS: Final = 8
JUDGED: Final = 150  # samples tell how far a mask spreads about a curve
# Of a strand, in widths: how far to the side a pixel may lie to belong to it, and how far ahead; it goes on where a
# pixel lies beyond the third.
AHEAD: Final = (
    1e-6  # pixels: what lies farther is ahead; the pixel on which one stands is not, however sums are rounded
)
SIDE: Final = 0.75
REACH: Final = 1.5
BEYOND: Final = 0.6
# The march along it: the slice ahead that a step moves to the centre of; the length of the last piece, and the rest
# below which there is none. In widths.
MAX_STEPS: Final = 24
STEP_FROM: Final = 0.2
STEP_TO: Final = 0.6
LAST: Final = 0.6
LAST_REST: Final = 0.5
# A rope thinner than the body's thinnest is looked at as if it were that wide, or the slices above would hold nothing.
# Of that width: the shortest rest.
SHORTEST: Final = 1 / 12


class Found(NamedTuple):
    """What a search by colour found in a window.

    Args:
        mask: (h,w) uint8, 0 or 255, C-contiguous, the plausible components alone.
        runs: (R,3) its rows of pixels, as ``Kernels.survey`` gives them.
        areas: (Q,) pixels of each component, largest first.
        box: Left, top, width and height of the rectangle around them, image pixels.
    """

    mask: Mask
    runs: Indices
    areas: Indices
    box: tuple[int, int, int, int]


class Kernels(OutlineKernels, SheetKernels, Protocol):
    """A module with these functions; arrays are C-contiguous float64 where nothing else is said."""

    def survey(
        self, mask: Mask, left: int, top: int, min_area: float, min_share: float
    ) -> tuple[Indices, Indices, tuple[int, int, int, int], bool]:
        """The plausible components of a mask, 8-connected, as rows of pixels.

        Args:
            mask: (h,w) uint8, C-contiguous, 0 = background.
            left: Image column of its first pixel.
            top: Image row of its first pixel.
            min_area: Smaller components are dropped, pixels.
            min_share: So are those smaller than this share of the largest.

        Returns:
            (R,3) row, first column, column past the last one, image coordinates, top to bottom and left to right;
            (Q,) the components' pixels, largest first; left, top, width and height of the box around them; whether
            any were dropped.
        """
        ...

    def cells(self, runs: Indices, size: int) -> tuple[Array, Array]:
        """The pixels of (R,3) runs gathered into squares of an edge: (M,2) centroids, (M,) counts.

        The centroid keeps what coarse cells would lose: 8 x 8 cells cost 0.5 % of the Calinski-Harabasz score of all
        pixels, at a fiftieth of their number.
        """
        ...

    def carried(self, mask: Mask, left: int, top: int, points: Array, reach: int) -> npt.NDArray[np.bool_]:
        """Whether a mask has a pixel at most ``reach`` from each of (N,2) image points: (N,)."""
        ...

    def median_depth(
        self,
        depth: npt.NDArray[Any],
        unit: float,
        mask: Mask,
        left: int,
        top: int,
        points: Array,
        reach: int,
        min_share: float,
    ) -> Array:
        """The median depth of the mask around each point.

        Args:
            depth: (H,W) uint16, float32 or float64; 0, negative, non-finite or absurd = invalid.
            unit: Metres in a unit of depth.
            mask: (h,w) uint8, C-contiguous.
            left: Image column of its first pixel.
            top: Image row of its first pixel.
            points: (N,2) image pixels.
            reach: How far around a point is looked, pixels.
            min_share: Of the mask's pixels there, that must have a valid depth.

        Returns:
            (N,) metres, NaN where too few have.
        """
        ...

    def best_matching_units(self, points: Array, nodes: Array) -> npt.NDArray[np.intp]:
        """The nearest node of each point: argmax of x.c - |c|^2/2.  (M,D), (K,D) -> (M,)."""
        ...

    def settle(self, points: Array, weight: Array, nodes: Array, first: Array, second: Array) -> Array:
        """Batch epochs of a self-organising map with a local-linear neighbourhood.

        Each node moves to the intercept of a line (on a lattice, a plane) fitted to its neighbours' bins over their
        index; a plain kernel mean would pull the ends of a chain inwards by 2 to 20 px.

        Args:
            points: (M,D).
            weight: (M,).
            nodes: (K,D).
            first: (E,P+1,K,K) moments of the neighbourhood in each epoch, see ``topology.Neighbourhood``.
            second: (E,P+1,P+1,K,K).

        Returns:
            (K,D) new nodes.
        """
        ...

    def unshrink(self, nodes: Array, share: float, closed: bool) -> Array:
        """Nodes (K,D) of a line, K >= 3, moved against their bend, by a share of their second difference.

        The ends of an open line move by 1/24 of their neighbour's.
        """
        ...

    def fold(self, outline: Array, width: float) -> Array:
        """The centreline of a ribbon, by folding its outline about its tips.

        Args:
            outline: (P,2) closed outline, pixels.
            width: The ribbon's width, pixels.

        Returns:
            (96,2) centreline from tip to tip, equidistant along the outline, in no particular direction.
        """
        ...

    def unexplained(self, outline: Array, curve: Array, reach: float) -> float:
        """The share of a ribbon's outline (P,2), every other point of it, that lies far from a curve (S,2).

        Far is more than ``reach`` and half the curve's widest step from all of its points.
        """
        ...

    def arc_length(self, curve: Array) -> Array:
        """(P,D) -> (P,) arc length from the first point."""
        ...

    def interpolate(self, curve: Array, arc: Array, at: Array) -> Array:
        """Points of a polyline at arc positions ``at``: (P,D), (P,), (N,) -> (N,D)."""
        ...

    def catmull_rom(self, nodes: Array, subdivisions: int = 4, closed: bool = False) -> Array:
        """A smooth curve through nodes, for uneven gaps too.

        Cubic Hermite pieces over the chord length with the three-point tangents of Catmull and Rom ("A Class of Local
        Interpolating Splines", 1974).

        Args:
            nodes: (K,D), K >= 3, no two neighbours equal.
            subdivisions: Pieces between two nodes.
            closed: Whether the last node is followed by the first.

        Returns:
            ((K-1) * subdivisions + 1, D) points, the nodes among them; (K * subdivisions, D) when closed.
        """
        ...

    def equidistant(self, curve: Array, arc: Array, count: int, margin: float, max_shift: float) -> Array:
        """Arc positions of points with equal chords.

        Args:
            curve: (P,D).
            arc: (P,) its arc length.
            count: How many, at least 2.
            margin: Arc length from the curve's ends to the first and last point.
            max_shift: Gaps by which a point may leave its place by arc length.

        Returns:
            (count,) arc positions, increasing.
        """
        ...

    def spread(self, points: Array, weight: Array, curve: Array) -> float:
        """Mean square distance of (M,D) weighted points from the tangents of a curve (P,D); of 150 or so of them."""
        ...

    def ribbon(
        self,
        mask: Mask,
        left: int,
        top: int,
        points: Array,
        weight: Array,
        nodes: Array,
        first: Array,
        second: Array,
        share: float,
        width: float,
        thinnest: float,
    ) -> tuple[Array, Array, npt.NDArray[np.bool_], float]:
        """The fine axis of a ribbon in a mask, from tip to tip, through the nodes of a chain that settles in it.

        Nodes that hang over the mask's ends are left out. From there the way goes on along the strand: to the middle
        of a slice ahead while there is more, then to the middle of the last piece, and on as far as the rest is long.

        Args:
            mask: (h,w) uint8, C-contiguous.
            left: Image column of its first pixel.
            top: Image row of its first pixel.
            points: (M,2) image pixels, the mask's samples.
            weight: (M,).
            nodes: (K,2) image pixels, K >= 3, from where the chain settles.
            first: Of the chain, see ``settle``.
            second: Of the chain.
            share: Of the chain, see ``unshrink``.
            width: The ribbon's, pixels.
            thinnest: The least width that can be measured.

        Returns:
            (P,2) pixels; (P,) their arc length; (P,) whether the mask carries them, or a pixel beside them; the mean
            square distance of the samples from their tangents, see ``spread``.
        """
        ...

    compiled: bool
    """Whether the first call of a function takes longer than the others."""
    reads_tables: bool
    """Whether a table of colours is faster than the rule that it was made of."""

    def table_mask(self, rgb: npt.NDArray[np.uint8], window: Window, table: npt.NDArray[np.uint64]) -> Mask:
        """The pixels of a window whose colour is in a table: (h,w) uint8, 0 or 255.

        Args:
            rgb: (H,W,3) uint8.
            window: Which of its pixels to read.
            table: See ``segmentation.table.colour_table``.
        """
        ...

    def seek(
        self,
        rgb: npt.NDArray[np.uint8],
        window: Window,
        table: npt.NDArray[np.uint64],
        step: int,
        min_area: int,
        min_share: float,
    ) -> Found:
        """``table_mask`` and ``survey`` in one, without reading every pixel.

        One pixel in ``step * step`` is looked at, in a lattice that lies fast in the image with every other row shifted
        by half a step. Components that hold none of these are left out, so whatever a disc of diameter
        1.25 * step + 1 fits into is found, and what is found is complete to the pixel.

        Args:
            rgb: (H,W,3) uint8.
            window: Which of its pixels count.
            table: See ``segmentation.table.colour_table``.
            step: 4 or 8 pixels.
            min_area: Components with fewer pixels are dropped.
            min_share: So are those smaller than this share of the largest.
        """
        ...
