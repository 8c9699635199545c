"""A cloud of points in space: the ``Observed`` of metres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from shape_obs.frame import FARTHEST, plain_array
from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.observed import MIN_SAMPLES, Samples
from shape_obs.geometry.outline import clockwise
from shape_obs.image.rope_tip import LAST, LAST_REST, MAX_STEPS, REACH, SHORTEST, SIDE, STEP_FROM, STEP_TO
from shape_obs.point_cloud.geodesics import chain, ring
from shape_obs.point_cloud.local_pca import Ribbon, measure
from shape_obs.point_cloud.unrolling import Chart, border, chart
from shape_obs.point_cloud.voxels import ConnectedVoxels, Piece, connect

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix
    from scipy.spatial import KDTree

if TYPE_CHECKING:  # a protocol's property accepts no other descriptor
    cached_property = property
else:
    from functools import cached_property

Array = npt.NDArray[np.float64]

_MOST: Final = 20_000  # points; more change nothing and cost time
_FEWEST: Final = 4  # samples that a sheet has
_RING: Final = 8.0  # widths: a ring is longer
_MAX_BRIDGED: Final = 0.5  # of a rope's axis
_MAX_PIECES: Final = 16  # and falls into no more: the cost of joining them grows with the cube of their number
# How near a point of the cloud lies if it carries a place: in widths, and in voxels where the cloud is sparse.
_NEAR: Final = (0.75, 2.0)
# Points farther from the middle than so many times the median do not belong to the object.
_FAR: Final = 12.0
_SOME: Final = 1000  # points from which the middle is estimated
# At a rope's tip. Noise throws single points far: the bulk must lie farther ahead than a pixel of a mask, in widths.
_BEYOND: Final = 0.8
_GAP: Final = (0.4, 5.0)  # the least gap between points that ends a strand, in widths and in usual gaps


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of one object in space.

    Args:
        points: ``(M, 3)`` metres, plausible ones.
    """

    points: Array
    unit: ClassVar[str] = "m"
    noun: ClassVar[str] = "cloud"
    sample_unit: ClassVar[str] = "points"
    dimension: ClassVar[int] = 3
    thinnest: ClassVar[float] = 3e-4

    @property
    def refusal(self) -> str:
        """Why the points are no object, in words; empty if they may be one."""
        if not self.pieces:
            return "the cloud is empty"
        few = f"the cloud has {self.area} points, at least {MIN_SAMPLES} are needed"
        return few if self.area < MIN_SAMPLES else ""

    @property
    def pieces(self) -> int:
        """How many pieces there are, specks left out."""
        return len(self.components)

    @cached_property
    def area(self) -> int:
        """Points, specks left out."""
        return len(self.kept)

    @property
    def kept(self) -> Array:
        """(M',3) metres, the points without specks."""
        return self._pieces.points

    @property
    def samples(self) -> Samples:
        """The points in voxels of half the object's width; of sheets, a fortieth of their extent."""
        return self._pieces.samples

    @property
    def links(self) -> csr_matrix:
        """(M',M') distances between connected samples, metres."""
        return self._pieces.links

    @property
    def components(self) -> tuple[Piece, ...]:
        """Connected pieces, largest first."""
        return self._pieces.components

    @cached_property
    def hidden_variance(self) -> float:
        """Variance across a strand that the samples hide, square metres: two of the three directions of a voxel."""
        offset = self.kept - self.samples.points[self._pieces.sample]
        return float(np.mean(np.sum(offset**2, axis=1))) * 2 / 3

    @cached_property
    def width(self) -> float:
        """Thickness, metres: sqrt(12) times the rms spread across the local axis; the short side of a sheet."""
        return max(self._ribbon.width, self.samples.scale) if len(self.kept) else 0.0

    @property
    def length(self) -> float:
        """Length of a rope-like cloud, metres."""
        return self._ribbon.length

    @property
    def resolution(self) -> float:
        """What the cloud resolves: the edge of a voxel, metres."""
        return self.samples.scale

    @property
    def ribbon_width(self) -> float:
        """The width that a spread in both directions across is compared with, metres."""
        return max(self._ribbon.spread_width, self.samples.scale)

    @property
    def box(self) -> None:
        """None: a cloud has no pixels."""
        return None

    @property
    def parts(self) -> tuple[Any, ...]:
        """The cloud itself."""
        return (self,)

    def gather(self, edge: float) -> Samples:
        """Return the cloud's samples: its voxels do not depend on an edge in pixels."""
        return self.samples

    def all_samples(self) -> Samples:
        """Return every point, each counting once."""
        return Samples(self.kept, np.ones(len(self.kept)), self.resolution)

    def extend_to_tips(self, nodes: Array) -> Array:
        """Cut a chain of nodes ``(K, 3)`` where it hangs over the cloud, and lengthen it to the rope's tips."""
        return _extend_chain(nodes, self, self.width)

    def connected_ahead(self, place: Array, points: Array, along: Array, width: float) -> npt.NDArray[np.bool_]:
        """Return which points near a place belong to its strand: those before the first wide gap.

        Args:
            place: ``(3,)`` metres.
            points: ``(P, 3)`` metres.
            along: ``(P,)`` how far ahead of the place each point lies, metres.
            width: Of the rope, metres.
        """
        return along <= _first_gap(along, width)

    def pixels_of(self, points: Array) -> Array | None:
        """Return None: the camera that saw the cloud is unknown."""
        return None

    def seen(self, points: Array, target: Array | None) -> Array:
        """Return points ``(N, 3)`` as an anchor is given; without one ``(N, 2)`` as seen along +z from top left."""
        if target is not None:
            return points
        return points[:, :2] - self.kept[:, :2].min(axis=0)

    def carries(self, points: Array) -> npt.NDArray[np.bool_]:
        """Return whether the cloud has points near ``(N, 3)`` places: ``(N,)`` bool."""
        return self.near(points)

    def near(self, points: Array) -> npt.NDArray[np.bool_]:
        """Return whether a sample lies within 3/4 of the width, or two voxels, of ``(N, 3)`` places: ``(N,)``."""
        reach = max(_NEAR[0] * self._ribbon.width, _NEAR[1] * self.samples.scale)
        # A sheet's width is its short side; a place on it is carried by a neighbouring voxel.
        reach = min(reach, _NEAR[1] * self.samples.scale)
        return np.asarray(self._tree.query(points)[0] <= reach)

    def around(self, place: Array, reach: float) -> Array:
        """Return ``(P, 3)`` the points within ``reach`` metres of a place ``(3,)``."""
        offset = self.kept - place
        return self.kept[np.einsum("md,md->m", offset, offset) <= reach**2]

    def outline_curve(self, hole: int | None = None) -> FittedCurve:
        """Return the closed boundary, clockwise as seen along +z: a ring's axis, or the border of a sheet."""
        points = self._sheet[0] if self._ring is None else self._ring
        return FittedCurve.through(points, np.zeros(len(points), bool), closed=True)

    def outline_samples(self) -> Samples:
        """Return the points of the boundary, weighted by arc length."""
        curve = self.outline_curve()
        step = np.diff(curve.arc)
        return Samples(curve.points, (step + np.roll(step, 1)) / 2, curve.size / len(curve.points))

    def outline_points(self, hole: int | None = None) -> Samples:
        """Return as many points at equal distances around the boundary, each counting once."""
        curve = self.outline_curve()
        count = len(curve.points)
        return Samples(curve.even(count), np.ones(count), curve.size / count)

    def sheet_outline(self) -> tuple[Array, Array]:
        """Return the outline of the sheet in space, ``(P, 3)``, and unrolled into a plane, ``(P, 2)``."""
        return self._sheet

    def to_space(self, flat: Array) -> Array:
        """Return places ``(N, 2)`` on the unrolled sheet in space, ``(N, 3)``."""
        return self.chart.to_space(flat)

    def axis(self) -> FittedCurve:
        """Return the axis of a rope from tip to tip, in no particular direction, without a previous frame."""
        found = chain(self.samples, self.links, [piece.samples for piece in self.components], self.width)
        doubt, gaps = found.doubt, float(found.bridged.mean())
        if not doubt and gaps > _MAX_BRIDGED:
            doubt = f"{gaps:.0%} of the curve would be gaps (at most {_MAX_BRIDGED:.0%})"
        return FittedCurve.through(found.points, found.bridged, ambiguity=doubt)

    @property
    def outlined_share(self) -> float:
        """The share of the cloud that the outline goes around: all of a ring, the largest piece of a sheet."""
        return 1.0 if self._ring is not None else self.components[0].area / max(self.area, 1)

    @cached_property
    def _ring(self) -> Array | None:
        if self.length < _RING * self.width or len(self.components) > _MAX_PIECES:
            return None
        around = ring(self.samples, self.links, [piece.samples for piece in self.components], self.width)
        return around if around is None or clockwise(around) else around[::-1]

    @cached_property
    def chart(self) -> Chart:
        """The map that takes places on the sheet to space and back."""
        return chart(self.samples, self.links)

    @cached_property
    def _sheet(self) -> tuple[Array, Array]:
        if len(self.samples) < _FEWEST:  # a point, as far as an outline goes
            return self.samples.points[:1], np.zeros((1, 2))
        around = border(self.chart.to_flat(self.kept, self._pieces.sample))
        return self.chart.to_space(around), around

    @cached_property
    def _ribbon(self) -> Ribbon:
        return measure(self._thinned)

    @cached_property
    def _tree(self) -> KDTree:
        from scipy.spatial import KDTree

        return KDTree(self.samples.points, balanced_tree=False, compact_nodes=False)

    @cached_property
    def _thinned(self) -> Array:
        if len(self.points) <= _MOST:
            return self.points
        return self.points[np.random.default_rng(0).choice(len(self.points), _MOST, replace=False)]

    @cached_property
    def _pieces(self) -> ConnectedVoxels:
        return connect(self._thinned, self._ribbon.width)


def read_cloud(points: Any) -> Cloud:
    """Return the cloud of an array: ``(M, 3)``, or organised as ``(H, W, 3)``, floating metres; masked are no points.

    Raises:
        TypeError: No floating array.
        ValueError: Another shape.
    """
    points = plain_array(points, "points", masked=np.nan)
    if not isinstance(points, np.ndarray) or not np.issubdtype(points.dtype, np.floating):
        came = f"an array of {points.dtype}" if isinstance(points, np.ndarray) else type(points).__name__
        raise TypeError(
            f"points: expected a numpy array of floating metres, got {came}; scale millimetres by 0.001, and stack the "
            "fields of a PointCloud2: np.stack([cloud['x'], cloud['y'], cloud['z']], axis=-1)."
        )
    if points.ndim not in (2, 3) or points.shape[-1] != 3:
        raise ValueError(
            f"points: expected shape (M, 3) or (H, W, 3), got {points.shape}; of (M, 4) or more give points[:, :3]."
        )
    return Cloud(plausible(points.reshape(-1, 3)))


def plausible(points: npt.NDArray[np.floating[Any]]) -> Array:
    """Return the points that can belong to one object: finite, non-zero, not absurdly far off.

    Args:
        points: ``(M, 3)`` metres.
    """
    points = points.astype(np.float64)
    points = points[(np.abs(points) < FARTHEST).all(axis=1) & points.any(axis=1)]
    if not len(points):
        return points
    some = points[:: -(-len(points) // _SOME)]
    middle = np.median(some, axis=0)
    typical = np.median(np.sum((some - middle) ** 2, axis=1))
    offset = points - middle
    return points[np.einsum("md,md->m", offset, offset) <= _FAR**2 * typical]


def _ahead(cloud: Cloud, front: Array, heading: Array, width: float) -> tuple[Array, Array]:
    """Return the strand that goes on from ``front`` ``(3,)`` in the direction ``heading``, a unit vector.

    Returns:
        ``(P, 3)`` its points from there; ``(P,)`` how far each lies ahead.
    """
    offset = cloud.around(front, REACH * width) - front
    along = offset @ heading
    side = np.sqrt(np.maximum(np.einsum("pd,pd->p", offset, offset) - along**2, 0.0))
    strand = (along > 0) & (side <= SIDE * width)
    # Another strand that passes ahead is no part of this one.
    strand[strand] = cloud.connected_ahead(front, front + offset[strand], along[strand], width)
    return offset[strand], along[strand]


def _first_gap(along: Array, width: float) -> float:
    """Return how far points are connected that lie ``(P,)`` ahead."""
    order = np.sort(np.append(along, 0.0))
    gap = max(_GAP[0] * width, _GAP[1] * REACH * width / len(order))
    return float(order[np.argmax(np.append(np.diff(order) > gap, True))])


def _extend_chain(nodes: Array, cloud: Cloud, width: float) -> Array:
    """Cut a chain of nodes where it hangs over the cloud, and lengthen it to the tips.

    ``shape_obs.image.rope_tip`` does the same in a mask.

    Args:
        nodes: ``(K, 3)`` metres, K >= 3.
        cloud: What they were fitted to.
        width: The rope's, metres.

    Returns:
        ``(K', 3)``; the first and last points lie on the tips.
    """
    width = max(width, cloud.thinnest)
    on = np.flatnonzero(cloud.carries(nodes))  # a prediction that overshoots leaves empty nodes past the end
    if len(on) and on[-1] - on[0] >= 2:
        nodes = nodes[on[0] : on[-1] + 1]
    head = _extension(nodes[:3], cloud, width)
    tail = _extension(nodes[:-4:-1], cloud, width)
    return np.concatenate([head[::-1], nodes, tail])


def _extension(start: Array, cloud: Cloud, width: float) -> Array:
    """Return the way ``(S, 3)`` from the end of a chain, the first of ``(3, 3)`` nodes, to the tip."""
    front, heading, rest = start[0], _bent(start[0] - start[1], start[1] - start[2]), 0.0
    path: list[Array] = []
    for _ in range(MAX_STEPS):
        offset, along = _ahead(cloud, front, heading, width)
        # Noise moves as many points forwards over the start as back, and at the far end it leaves the mean alone. So
        # the length is twice the mean, for points that are spread evenly.
        rest = 2 * float(along.mean()) if len(along) else 0.0
        if rest > _BEYOND * width:
            piece = (along > STEP_FROM * width) & (along <= STEP_TO * width)
        elif rest > LAST_REST * width:
            piece = along > rest - LAST * width
        else:
            break
        if not piece.any():
            break
        step = offset[piece].mean(axis=0)
        heading = _bent(step, heading)
        front = front + step
        path.append(front)
    return np.array([*path, front + heading * max(rest, SHORTEST * cloud.thinnest)])


def _bent(ahead: Array, before: Array) -> Array:
    """Return the heading after two chords: on a circle the tangent turns twice as far as a chord; half is added."""
    ahead, before = (way / max(float(np.linalg.norm(way)), 1e-9) for way in (ahead, before))
    heading = ahead + (ahead - before) / 2
    return heading / max(float(np.linalg.norm(heading)), 1e-9)
