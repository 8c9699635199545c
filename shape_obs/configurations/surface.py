"""Surface: a cloth or a towel as a lattice of points, row by row, each on its material."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.interpolate import RegularGridInterpolator

from shape_obs.compiled import Kernels
from shape_obs.compiled.interface_outline import FINE, RIM
from shape_obs.configurations.base import Configuration, Ends, Origin, Points
from shape_obs.geometry.form import Patch
from shape_obs.geometry.samples import Samples
from shape_obs.geometry.topology import Grid, Topology
from shape_obs.image.region import Region
from shape_obs.initialization.corners import Indices, Rim
from shape_obs.point_cloud.body import Body
from shape_obs.point_cloud.cloud import Cloud
from shape_obs.tracking.occlusion import STRAYED, strayed_corner, strays
from shape_obs.tracking.prediction import Prediction
from shape_obs.tracking.validation import Verdict, judge_sheet

Array = npt.NDArray[np.float64]

_NODES: Final = 8  # rows and columns that are remembered from frame to frame, whatever lattice is sampled
_MIN_SIDE: Final = 6.0  # grains: what is narrower has no two sides to speak of
_MAX_ASPECT: Final = 8.0  # length over width; what is longer is a ribbon, whose corners are its ends
_CELL: Final = 8  # pixels
_WIDTH: Final = 0.5  # of the map's neighbourhood, nodes
_MAX_CUT: Final = 0.03  # of the outline
_MIN_PIECE: Final = 0.8  # of the body: the largest piece, since a sheet has no way to hang together over a gap


@dataclass(frozen=True)
class Surface(Configuration[Patch], kind="surface"):
    """A lattice over a sheet with four corners, row by row from its top left.

    Args:
        rows: How many points from top to bottom.
        cols: How many from left to right.
        ends: ``"centers"``: the points are centres of rows x cols equal pieces, as cluster centres are; ``"tips"``:
            the outer rows and columns lie on the border. None takes the detector's.
        epochs: Of the self-organising map, after the Coons patch. None by default: what is seen of a sheet's material
            is its outline. Each epoch evens the areas out and takes the points nearer to cluster centres and off their
            material (1.1, 1.3, 1.6 px over drawn sheets with 0, 1, 3), and away from whatever hides the inside.
        freedom: How far a corner may move from one frame to the next that the three others do not, as a share of half
            a diagonal. Beyond it something lies over that corner, and the shape is refused. Where grippers move
            single corners give more.
    """

    rows: int = 4
    cols: int = 8
    ends: Ends | None = None
    epochs: int = 0
    freedom: float = STRAYED

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (2 <= self.rows <= 100 and 2 <= self.cols <= 100):
            raise ValueError(f"surface: rows and cols must lie in 2...100, got {self.rows} and {self.cols}.")
        if not 0 <= self.epochs <= 100:
            raise ValueError(f"surface: epochs must lie in 0...100, got {self.epochs}.")
        if not 0 < self.freedom <= 1:
            raise ValueError(f"surface: freedom must lie above 0, up to 1, got {self.freedom}.")

    @property
    def layout(self) -> Grid:
        """A lattice of rows x cols points."""
        return Grid(self.rows, self.cols)

    def unfit(self, body: Body) -> str:
        """Return why a body cannot hold a sheet: a speck, a ribbon, pieces, corners out of sight, or no outline."""
        if body.width < _MIN_SIDE * body.grain:
            return f"the {body.noun} is {body.width:.3g} {body.unit} wide: too small for a sheet"
        if body.stretch > _MAX_ASPECT * body.width:
            return f"the {body.noun} is {body.stretch:.4g} x {body.width:.4g} {body.unit}: too slender for a sheet"
        if isinstance(body, Region):
            piece, cut = body.outlined, _cut(body)
            if piece < _MIN_PIECE:
                return f"the mask falls into {body.pieces} pieces, and the largest is {piece:.0%} of it"
            if cut > _MAX_CUT:
                return f"{cut:.0%} of the outline lies on the image's edge: the sheet's corners are out of sight"
        elif not np.ptp(body.sheet().outline_flat, axis=0).any():
            return f"the outline of the {body.noun} has no extent"
        return ""

    def samples(self, body: Body) -> Samples:
        """All of the body, fine enough for the nodes."""
        return body.gathered(_CELL) if isinstance(body, Region) else body.samples

    def topology(self, body: Body) -> Grid:
        """A lattice of 8 x 8 nodes, to be remembered."""
        return Grid(_NODES, _NODES)

    def parameterise(self, body: Body) -> Patch:
        """A Coons patch between the corners of the outline, numbered by the paper's rule."""
        rim = _rim(body)
        corners, doubt = rim.corners(), ""
        if corners is None:
            doubt = f"the outline has {len(rim.candidates)} corners, a sheet has four"
            corners = np.arange(4) * (RIM // 4)
        form = replace(_laid(rim, corners, body), doubt=doubt)
        return self.numbered(form, body.seen(form.points, None), None)

    def nodes(self, form: Patch, topology: Topology) -> Array:
        """The centres of K equal pieces."""
        assert isinstance(topology, Grid)
        return form.evenly(topology.rows, topology.cols, centers=True)

    def warm(self, body: Body, prediction: Prediction) -> Array:
        """On the patch between the corners nearest to the predicted ones; over a mask without a map, as predicted.

        Nodes that no map moves tell ``finish`` nothing but where the corners are expected.
        """
        if not self.epochs and isinstance(body, Region):
            return prediction.nodes
        rim = _rim(body)
        corners = rim.corners_near(_corners(prediction.nodes, prediction.topology, rim.kernels))
        return prediction.nodes if corners is None else self.nodes(_laid(rim, corners, body), prediction.topology)

    def widths(self, origin: Origin) -> tuple[float, ...]:
        """As many epochs as are asked for."""
        return self.epochs * (_WIDTH,)

    def finish(self, nodes: Array, body: Body) -> Patch:
        """The Coons patch between the corners nearest to the nodes', its inside moved where the map has moved them."""
        lattice = self.topology(body)
        form = _found(lattice.lattice(nodes), body)
        if form is None:
            return replace(self.parameterise(body), doubt="the outline's corners are not where the lattice's are")
        points = form.points
        if self.epochs:
            moved = lattice.lattice(nodes - self.nodes(form, lattice))
            points = points + _over(form, moved)
        return Patch(points, ~body.carries(points), form.rows, form.kink, kernels=form.kernels)

    def judge(self, form: Patch, body: Body, bridged: float) -> Verdict:
        """As a sheet; over a cloud as it lies unrolled, where a bent side does not wind."""
        if form.doubt:
            return Verdict(form.doubt, 0.0)
        if isinstance(body, Cloud):
            rim = _rim(body)
            corners = rim.corners_near(form.corners)
            if corners is None:
                return Verdict("the lattice's corners are not in order around the outline", 0.0)
            points, kink = rim.laid(corners)
            form = replace(form.measured(points), kink=kink)
        return judge_sheet(form, body, math.degrees(form.kink))

    def numbered(self, form: Patch, seen: Array, target: Array | None) -> Patch:
        """The first corner nearest the target; else rows run to the right and columns down, as far as they can."""
        if target is not None:
            corners = form.measured(seen).corners
            return form.turned(int(np.argmin(np.sum((corners - target) ** 2, axis=1))))
        lattice = form.measured(seen).lattice
        right, down = (lattice[:, -1] - lattice[:, 0]).mean(axis=0), (lattice[-1] - lattice[0]).mean(axis=0)
        right, down = (way / max(float(np.linalg.norm(way)), 1e-9) for way in (right, down))
        level, upright = right[0] + down[1], down[0] - right[1]
        return form.turned(int(np.argmax([level, upright, -level, -upright])))

    def follow(self, form: Patch, prediction: Prediction) -> Patch:
        """Turned so that its corners lie nearest to the predicted ones; in doubt if one of them is not the sheet's."""
        assert isinstance(prediction.topology, Grid)
        expected = prediction.topology.lattice(prediction.nodes)
        if expected.shape[2] == 2:
            quarters, corner, share = form.kernels.strayed(expected, form.lattice)
            doubt = strays(corner, share, self.freedom)
        else:
            expected, corners = form.kernels.outer_corners(expected), form.corners
            away = [np.sum((np.roll(corners, -turn, axis=0) - expected) ** 2) for turn in range(4)]
            quarters = int(np.argmin(away))
            doubt = strayed_corner(expected, np.roll(corners, -quarters, axis=0), self.freedom)
        turned = form.turned(quarters)
        return replace(turned, doubt=form.doubt or doubt) if doubt else turned

    def place(self, form: Patch, metric: Patch) -> Points:
        """Equal gaps down and across, on the mean over the lattice."""
        ends = self.ends or "centers"
        if form is metric and not np.count_nonzero(form.bridged):
            return Points(form.evenly(self.rows, self.cols, centers=ends == "centers"), np.zeros(self.count, bool))
        at = _spread(metric, self.rows, self.cols, ends)
        return Points(form.at(*at), form.bridged_at(*at))


def _cut(region: Region) -> float:
    """The share of the outline that runs along the edge of the window."""
    (left, top, width, height), box = region.window, region.box
    if (
        left < box.left
        and top < box.top
        and box.left + box.width < left + width
        and box.top + box.height < top + height
    ):
        return 0.0
    place = region.border.traced - (region.window.left, region.window.top)
    return float(np.mean(np.any((place <= 0) | (place >= (width - 1, height - 1)), axis=1)))


def _rim(body: Body) -> Rim:
    """The outline of a body's largest piece; of a cloud as unrolled."""
    if isinstance(body, Cloud):
        sheet = body.sheet()
        return Rim.along(sheet.outline, sheet.outline_flat)
    return Rim.around(body.border)


def _found(nodes: Array, body: Body) -> Patch | None:
    """The Coons patch between the corners nearest to those of a lattice of nodes (R,C,D); None if out of order."""
    if isinstance(body, Region):
        points, kink = body.kernels.tracked(*body.border.rim, nodes)
        return _patch(points, kink, body) if len(points) else None
    rim = _rim(body)
    corners = rim.corners_near(body.kernels.outer_corners(nodes))
    return None if corners is None else _laid(rim, corners, body)


def _laid(rim: Rim, corners: Indices, body: Body) -> Patch:
    """The Coons patch between four corners; for a cloud in its unrolled plane, then put back onto the sheet."""
    points, kink = rim.laid(corners)
    return _patch(body.chart.to_space(points) if isinstance(body, Cloud) else points, kink, body)


def _patch(points: Array, kink: float, body: Body) -> Patch:
    return Patch(points, np.zeros(len(points), bool), FINE, kink, kernels=body.kernels)


def _spread(form: Patch, rows: int, cols: int, ends: Ends) -> tuple[Array, Array]:
    """Places on a patch, (rows,) down and (cols,) across, with equal gaps on the mean over the patch."""
    found = []
    for count, gauge in zip((rows, cols), form.gauges, strict=True):
        share = np.linspace(0, 1, count) if ends == "tips" else (np.arange(count) + 0.5) / count
        found.append(np.interp(share * gauge[-1], gauge, np.arange(len(gauge))))
    return found[0], found[1]


def _over(form: Patch, moved: Array) -> Array:
    """(P,D) how the points of a patch move with its nodes: (R,C,D) at the nodes, nothing at the border."""
    places = _spread(form, moved.shape[0], moved.shape[1], "centers")
    ends = [len(gauge) - 1 for gauge in form.gauges]
    down, across = (np.concatenate([[0.0], at, [end]]) for at, end in zip(places, ends, strict=True))
    motion = RegularGridInterpolator((down, across), np.pad(moved, ((1, 1), (1, 1), (0, 0))), method="linear")
    fine = np.stack(np.meshgrid(np.arange(ends[0] + 1), np.arange(ends[1] + 1), indexing="ij"), axis=-1)
    return motion(fine.reshape(-1, 2))


def _corners(nodes: Array, topology: Topology, kernels: Kernels) -> Array:
    """(4,D) where the corners of a sheet belong whose pieces have their centres at the nodes, clockwise."""
    assert isinstance(topology, Grid)
    return kernels.outer_corners(topology.lattice(nodes))
