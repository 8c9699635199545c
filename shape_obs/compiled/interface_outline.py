"""What a backend offers for outlines and sheets, beside ``Kernels``' other functions, and the figures both hold to."""

from __future__ import annotations

from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.uint8]
Box = tuple[int, int, int, int]

SPECK: Final = 20  # pixels around a hole; shorter ones are noise

# Smoothing along an outline, in its steps: enough to see a direction and a length through the staircase of pixels, at
# 0.2 px off a bend of radius 10. What is fitted is not smoothed.
STAIRCASE: Final = 2.0
STAIRCASE_REACH: Final = 4

# Of the phase of an outline. How much its place and direction in the image weigh beside its shape, whose match is
# worth 1. A square fits itself four ways, a towel two: the way that turns least is chosen.
TURNING: Final = 0.05
# Within a fit, place decides only where the shape says nothing, as on a circle: a weight that shrinks as the shape's
# own contrast grows beyond it, since what is predicted of a turning outline lags behind.
FLAT: Final = 3e-4
# Waves around the outline that are compared: more cost time and change nothing, and on a noisy circle they mislead.
HARMONICS: Final = 12
# Shifts at which a peak is looked for, ten to the shortest wave, and half-widths of the parabolas through it, in turns;
# the correlation is a sum of few waves, so it is known between the shifts too.
SHIFTS: Final = 128
PEAKS: Final = (0.5 / 128, 0.1 / 128)

CELL: Final = 2  # points of a border in one sample: half the work, and no bend is lost
JUDGED_AROUND: Final = 256  # samples of an outline tell how far it is missed

RIM: Final = 400  # points of a sheet's rim
REACH_OF_TURN: Final = 16  # points on either side: the scale at which a turn is a corner, 4 % of the perimeter
CANDIDATES: Final = 10
LEAST_TURN: Final = 0.35  # radians; the corners of a sheet turn more, wherever it bends
# The smoothing of the outline has rounded its corners: so many of the outline's own steps to either side are left
# out, and a corner is looked for no farther off.
ROUNDED: Final = 4.0
OUTSIDE: Final = 2.5
# Lines that are intersected at a corner, in points: longer ones would cut across bent sides, shorter ones follow the
# noise. 0.4 px off at the median of drawn sheets; the strongest turn itself is 1.4 px off.
LINE: Final = 6
# How far from where a corner is expected it is looked for, in points: half of the least side of a sheet of 1:4.
NEAR: Final = 20
PARALLEL: Final = 0.1  # squared sine of the angle between two sides that meet in no corner
FINE: Final = 25  # rows and columns of a patch: between them it is taken to be bilinear, 0.1 px off


class OutlineKernels(Protocol):
    """Outlines: closed curves of (P,D) points, the first not repeated; D is 2 where nothing else is said."""

    def traced(self, mask: Mask, runs: Indices, left: int, top: int, box: Box) -> tuple[Array, float, float]:
        """The outline of a mask of one piece.

        Args:
            mask: (h,w) uint8, C-contiguous, 0 = background, 8-connected.
            runs: (R,3) its rows of pixels.
            left: Image column of its first pixel.
            top: Image row of its first pixel.
            box: Left, top, width and height of the box around the piece, image coordinates.

        Returns:
            (P,2) image pixels, closed, 8-connected, through the centres of the border pixels, in OpenCV's order; its
            length; and the length of the outlines of its holes, pixels, specks left out.
        """
        ...

    def border(self, traced: Array, hole: bool) -> tuple[Array, Array]:
        """Where the material ends, clockwise as seen: with the staircase of pixels, and without.

        Per step along its main direction, a straight border runs through pixels that lie 0 to 1 px inside the edge,
        along the other axis: half a pixel on average there, so 0.5 max(|n_u|, |n_v|) along the normal n.

        Args:
            traced: (P,2) through the centres of the border pixels, either way round.
            hole: Whether the material lies outside.

        Returns:
            (P,2) the border, and (P,2) the same smoothed.
        """
        ...

    def pairs(self, points: Array) -> Array:
        """The mean of each two points, the last alone where they are odd: (P,D) -> (ceil(P/2),D); any D."""
        ...

    def ring(
        self, points: Array, smooth: Array, place: Array, count: int, sigma: float, pieces: int
    ) -> tuple[Array, float]:
        """The smooth closed curve through the nodes of a ring that settles on a border, in one epoch.

        Nodes start at equal distances around the smoothed border, and what they settle on are its points, two by two.
        Both have their order, so a sample looks for its node where it lies along the border, and never takes one of
        the other side of what is thin.

        Args:
            points: (P,2) the border.
            smooth: (P,2) the same smoothed.
            place: (2,) the first node starts at the border's point nearest to it.
            count: How many nodes.
            sigma: Width of the map's neighbourhood, nodes.
            pieces: Of the curve between two nodes.

        Returns:
            (count*pieces,2) the curve; the mean distance of its samples from its tangents.
        """
        ...

    def followed(
        self, points: Array, reference: Array, predicted: Array, share: float
    ) -> tuple[Array, Array, Array, Array]:
        """An outline renumbered from where it began before.

        Args:
            points: (P,2).
            reference: (K,2) equidistant around the outline as it was, wherever it lay.
            predicted: (K,2) the same nodes where they are expected.
            share: How far the reference moves towards what was found.

        Returns:
            (P',2) the same outline from there on, P' = P or P + 1; (P'+1,) its arc length, the last entry the whole;
            (K,2) equidistant places on it; (K,2) the reference laid over them and moved towards them.
        """
        ...

    def lag(self, reference: Array, predicted: Array, found: Array) -> float:
        """Where an outline's numbering begins: node k of the past is now at ``found[k + lag]``; all (K,2)."""
        ...

    def blend(self, reference: Array, found: Array, share: float) -> Array:
        """The reference laid over what was found, and moved towards it: (K,2), (K,2) node by node -> (K,2)."""
        ...

    def miss(self, points: Array, curve: Array, size: float) -> float:
        """Mean distance of (M,D) points from the tangents of a curve (P,D), which is ``size`` long; any D."""
        ...


class SheetKernels(Protocol):
    """Sheets: rims of 400 points and lattices of (R,C,D) points; D is 2 where nothing else is said."""

    def rim(self, outline: Array) -> tuple[Array, Array, Indices, float, float]:
        """An outline, clockwise, as the rim of a sheet.

        Returns:
            (400,2) points evenly spaced; (400,) radians by which it turns about each, positive where it is convex; (Q,)
            the points where it turns most, in order, at most ten; the distance between two points; the outline's own.
        """
        ...

    def corners_near(self, rim: Array, candidates: Indices, step: float, expected: Array) -> Indices:
        """The candidate nearest to each place, or the rim's nearest point where there is none; any D.

        Args:
            rim: (400,D).
            candidates: (Q,) the points where it turns most.
            step: Distance between two points.
            expected: (4,D) clockwise as seen.

        Returns:
            (4,) points; (0,) when they are not in order around the rim.
        """
        ...

    def laid(self, rim: Array, turn: Array, corners: Indices, step: float, grain: float) -> tuple[Array, float]:
        """The Coons patch between four corners of a rim.

        Args:
            rim: (400,2).
            turn: (400,) its turns.
            corners: (4,) points, clockwise.
            step: Distance between two points.
            grain: What the outline was smoothed over.

        Returns:
            (625,2) a lattice of 25 rows and columns, the first along the side from the first corner to the second; and
            by how many radians the rim turns at most, either way, where it is away from the corners.
        """
        ...

    def tracked(
        self, rim: Array, turn: Array, candidates: Indices, step: float, grain: float, nodes: Array
    ) -> tuple[Array, float]:
        """``laid`` between the ``corners_near`` the ``outer_corners`` of (R,C,2) nodes; (0,2) points without them."""
        ...

    def gauges(self, lattice: Array) -> tuple[Array, Array]:
        """How far down each row lies (R,), and how far right each column (C,): mean distances added up; any D."""
        ...

    def sampled(self, lattice: Array, down: Array, right: Array, rows: int, cols: int, centers: bool) -> Array:
        """A smaller lattice with equal gaps on the mean, bilinear in between; any D.

        Args:
            lattice: (R,C,D).
            down: (R,) how far down each row lies.
            right: (C,) how far right each column.
            rows: How many.
            cols: How many.
            centers: The points are the centres of equal pieces; else the outer ones lie on the border.

        Returns:
            (rows*cols,D).
        """
        ...

    def outer_corners(self, nodes: Array) -> Array:
        """(4,D) where the corners of a sheet belong whose pieces have their centres at (R,C,D) nodes, clockwise."""
        ...

    def strayed(self, nodes: Array, lattice: Array) -> tuple[int, int, float]:
        """How a sheet's corners are numbered, and which one lies farthest from where the other three put it.

        The three others are laid over where they were expected by a similarity transform (S. Umeyama, "Least-Squares
        Estimation of Transformation Parameters Between Two Point Patterns", 1991), and the fourth has to follow. Of
        complex numbers it is one product: the least squares of ``found = a expected + b``.

        Args:
            nodes: (R,C,2) predicted.
            lattice: (R',C',2) found.

        Returns:
            By how many quarters the found lattice is to be turned, so that its corners lie nearest to the predicted
            ones; then which of them strays most, and by which share of half a diagonal.
        """
        ...

    def assessed(self, lattice: Array) -> tuple[float, float, float, float]:
        """How much like a sheet a lattice is.

        Returns:
            The corner that is farthest from a right angle, degrees; the share of cells that face away from a neighbour;
            by which share a side is longer than the way from corner to corner, at most; standard deviation over mean of
            the cells' areas.
        """
        ...
