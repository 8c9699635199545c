"""What is seen of a sheet's border in a frame, and what is known of the sheet from the frames before."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.frame import FARTHEST, MILLIMETRE, depth_images
from shape_obs.geometry.coons import RIM, SIDE, TURN_REACH, border_of, side_lengths
from shape_obs.geometry.curve import TrackHints
from shape_obs.geometry.polyline import arc_length
from shape_obs.geometry.rotation import laid_flat, similarity
from shape_obs.image.region import Region
from shape_obs.initialization.corners import Rim
from shape_obs.tracking.complete_lattice import Border, Lens, complete_border, look_around
from shape_obs.tracking.model import (  # noqa: F401 - the first in a signature
    LatticeConstants,
    LatticeModel,
    Model,
    gain_of,
)
from shape_obs.tracking.predict import Prediction
from shape_obs.tracking.register_lattice import assign_corners, known_slack, zoom_of

if TYPE_CHECKING:
    from shape_obs.camera import Intrinsics

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

_SOME: Final = 4  # every so many points of a lattice give the median distance


@dataclass(frozen=True, eq=False)
class SheetView:
    """The outline of a sheet in an image.

    Args:
        region: Its mask.
        rim: ``(400, 2)`` pixels, see ``rim_of``, as are the next four.
        turn: ``(400,)`` radians.
        candidates: ``(Q,)`` points.
        step: Pixels.
        grain: Pixels.
        space: ``(400, D)`` the rim in metres where there is depth, else in pixels.
        cut: ``(400,)`` bool, see ``look_around``.
        camera: The projection where there is depth, else None.
        width: Of the mask's largest piece, pixels.
        lens: Focal lengths and principal point, if the camera is a pinhole.
        model: The constants.
    """

    region: Region
    rim: Array
    turn: Array
    candidates: Indices
    step: float
    grain: float
    space: Array
    cut: npt.NDArray[np.bool_]
    camera: Intrinsics | None
    width: float
    lens: Lens
    model: LatticeModel

    @property
    def scale(self) -> float:
        """The length of a pixel along the rim, metres, or 1."""
        return 1.0 if self.camera is None else float(arc_length(_closed(self.space))[-1]) / (RIM * self.step)

    def pixels(self, points: Array) -> Array | None:
        """Return points as pixels; None if the camera does not see some of them."""
        if self.camera is None:
            return points
        pixels = self.camera.project(points)
        return pixels if np.isfinite(pixels).all() else None

    def sees_through(self, patch: Array, lattice: Array, depth: npt.NDArray[Any]) -> bool:
        """Return whether the camera sees what lies behind a sheet in more than a few places.

        Args:
            patch: ``(P, 3)`` metres.
            lattice: ``(P, 2)`` the same in pixels.
            depth: ``(H, W)`` the frame's.
        """
        readable, unit = depth, MILLIMETRE if depth.dtype == np.uint16 else 1.0
        column, row = np.rint(lattice).astype(np.int64).T
        within = (row >= 0) & (row < readable.shape[0]) & (column >= 0) & (column < readable.shape[1])
        behind = np.zeros(len(patch))
        behind[within] = readable[row[within], column[within]] * unit
        through = (behind < FARTHEST) & (behind > patch[:, 2] + self.model.behind)
        return float(np.mean(through & ~self.region.carries(lattice))) > self.model.max_seen_through

    def turns_in_sheet(self, depth: npt.NDArray[Any]) -> Array:
        """Return ``(400,)`` radians by which the outline turns within the sheet, which bending does not change.

        A border that bends out of the sheet's plane turns in the image and not within the sheet; a fold's edge does.
        """
        back, ahead = np.roll(self.rim, TURN_REACH // 2, axis=0), np.roll(self.rim, -TURN_REACH // 2, axis=0)
        along = ahead - back
        inwards = np.stack([-along[:, 1], along[:, 0]], axis=1)
        inwards /= np.maximum(np.linalg.norm(inwards, axis=1, keepdims=True), 1e-9)
        inner = self.rim + self.model.inner * self.region.width * inwards
        lifted, _ = look_around(
            self.region, np.ascontiguousarray(inner), depth_images(depth), self.camera, None, self.model.depth_limits
        )
        if lifted is None:
            return np.zeros(len(self.rim))
        before = self.space - np.roll(self.space, TURN_REACH, axis=0)
        after = np.roll(self.space, -TURN_REACH, axis=0) - self.space
        normal = np.cross(before + after, lifted - self.space)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        before -= (before * normal).sum(axis=1, keepdims=True) * normal
        after -= (after * normal).sum(axis=1, keepdims=True) * normal
        return np.arctan2((np.cross(before, after) * normal).sum(axis=1), (before * after).sum(axis=1))

    def best_corners(self) -> Indices | None:
        """Return ``(4,)`` the points most like the corners of a sheet, clockwise; None if there are not four."""
        return Rim(self.rim, self.rim, self.turn, self.candidates, self.step, self.grain).corners()


@dataclass(frozen=True, eq=False)
class KnownSheet:
    """What is known of a sheet.

    Args:
        expected: ``(96, 2)`` pixels, its border where it is predicted.
        lattice: ``(625, D)`` the sheet as it was, wherever it lay, in metres if that is known, else in pixels.
        sides: ``(4,)`` the lengths of its sides in the same unit.
        hints: What the track stores.
        lasted: Seconds for which this frame counts.
        model: The constants.
    """

    expected: Array
    lattice: Array
    sides: Array
    hints: TrackHints
    lasted: float
    model: LatticeModel

    @classmethod
    def of(cls, prediction: Prediction, view: SheetView) -> KnownSheet:
        """Return what a track knows, in metres if it does and this frame can be compared with that."""
        expected, hints = border_of(prediction.nodes), prediction.track.hints
        if hints.reference is None or hints.sides is None or (hints.reference.shape[1] == 3 and view.camera is None):
            return cls(expected, prediction.nodes, side_lengths(expected), hints, prediction.lasted, view.model)
        return cls(expected, hints.reference, hints.sides, hints, prediction.lasted, view.model)

    @property
    def metric(self) -> bool:
        """Whether lengths are metres."""
        return self.lattice.shape[1] == 3

    def slack(self, view: SheetView) -> Array:
        """Return ``(4,)`` by how much a side may be off."""
        scale = view.scale if self.metric else 1.0
        return known_slack(self.sides, self.model.length_tolerance[self.metric], self.model.border_noise * scale)

    def seen_beside(self, border: Border, patch: Array) -> TrackHints:
        """Return what is known after a frame in which a part of the border was put back.

        Without depth all sides grow and shrink as those do that are seen from corner to corner.
        """
        if self.metric:
            return self.hints._replace(reference=patch)
        whole = border.seen.reshape(4, SIDE).all(axis=1) & np.roll(border.seen, -1).reshape(4, SIDE)[:, -1]
        if not whole.any() or self.hints.sides is None or self.lattice is not self.hints.reference:
            return self.hints
        share = float(np.median(side_lengths(border.points)[whole] / self.sides[whole]))
        most = self.model.max_stretch[True] * self.lasted
        return self.hints._replace(sides=self.sides * np.clip(share, 1 - most, 1 + most))

    def complete(self, view: SheetView, depth: npt.NDArray[Any] | None) -> Border | None:
        """Return the whole border, put back where it is hidden; None if too little of it is seen."""
        space = view.space if self.metric else view.rim
        arc, slack, model = arc_length(_closed(space)), self.slack(view), self.model
        places = view.candidates[~view.cut[view.candidates]]
        expected = np.ascontiguousarray(self.expected[::SIDE])
        at, spread = np.ascontiguousarray(view.rim[places]), model.corner_spread[self.metric]
        whole = float(arc[-1])
        found, cost = assign_corners(expected, at, arc[places], whole, self.sides, slack, spread, model.record)
        if not np.isfinite(cost):
            return None
        corners = np.where(found >= 0, places[found], -1)
        kinks = np.zeros(RIM, bool)
        if self.metric and depth is not None:
            turns = np.abs(view.turns_in_sheet(depth)) > model.fold_turn
            near = np.abs((np.arange(RIM) - corners[corners >= 0][:, None] + RIM // 2) % RIM - RIM // 2) <= TURN_REACH
            kinks = turns & ~near.any(axis=0)
        known = border_of(self.lattice)
        pattern = self.expected if self.metric else known
        bend = model.border_bend[self.metric]
        return complete_border(
            pattern, known, view.rim, space, corners, view.cut, kinks, self.sides, slack, bend, model
        )


@compiled
def learn_sheet(known: Array, patch: Array, sides: Array, lasted: float, model: Any) -> tuple[Array, Array]:
    """Return what is known of a sheet after a frame in which all of it was seen: its lattice, and its sides ``(4,)``.

    Args:
        known: ``(625, D)`` as it was, wherever it lay: metres or pixels.
        patch: ``(625, D)`` as it lies.
        sides: ``(4,)`` lengths.
        lasted: Seconds for which this frame counts.
        model: The constants, one ``LatticeModel``.
    """
    metric, lengths, learnt = known.shape[1] == 3, side_lengths(border_of(patch)), np.empty(4)
    zoom = 1.0 if metric else zoom_of(lengths, sides, model.max_zoom)
    for k in range(4):
        stretch = model.max_stretch[1 if metric else 0] * lasted * sides[k] * zoom
        learnt[k] = sides[k] * zoom + min(max(lengths[k] - sides[k] * zoom, -stretch), stretch)
    if metric:
        return patch, learnt
    laid = laid_flat(known, similarity(known, patch, np.ones(len(known), np.bool_)))
    far, most = _apart(patch, laid), model.max_stretch[1] * lasted * learnt.mean()
    limit = max(model.outlier * np.median(far[::_SOME]), model.form_noise)
    gain = gain_of(lasted, model.form_memory)
    for p in range(len(patch)):
        share = gain * ((limit / far[p]) ** 4 if far[p] > limit else 1.0)
        for d in range(2):
            laid[p, d] += min(max(share * (patch[p, d] - laid[p, d]), -most), most)
    return laid, learnt


@compiled("(f8[:,::1], f8[:,::1], f8, LatticeConstants[::1])")
def doubtful_places(known: Array, patch: Array, gap: float, model: Model) -> npt.NDArray[np.bool_]:
    """Return which points of a lattice are not where the known form has them, without depth, ``(625,)``.

    Something may lie over a border there that hides too little to be noticed by the border alone.

    Args:
        known: ``(625, 2)`` pixels, as it was, wherever it lay.
        patch: ``(625, 2)`` as it lies.
        gap: Between two points that are asked for, pixels.
        model: ``(1,)`` the constants.
    """
    share, pixels = model[0].hidden_place[0], model[0].hidden_place[1]
    near, out = np.ones(len(patch), np.bool_), np.zeros(len(patch), np.bool_)
    for last in (False, True):
        far = _apart(patch, laid_flat(known, similarity(known, patch, near)))
        if not last and far.max() <= max(share * gap, pixels):
            break
        own = model[0].outlier * np.median(far[::_SOME])
        limit = max(share * gap, pixels, own) if last else max(own, pixels)
        for p in range(len(patch)):
            near[p], out[p] = far[p] <= limit, far[p] > limit
    return out


@compiled
def _apart(points: Array, others: Array) -> Array:
    """Return ``(P,)`` the distances of ``(P, 2)`` points from as many others."""
    far = np.empty(len(points))
    for p in range(len(points)):
        x, y = points[p, 0] - others[p, 0], points[p, 1] - others[p, 1]
        far[p] = math.sqrt(x * x + y * y)  # several times as fast as ``hypot``
    return far


def _closed(points: Array) -> Array:
    return np.ascontiguousarray(np.concatenate([points, points[:1]]))
