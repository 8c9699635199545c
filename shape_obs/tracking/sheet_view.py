"""What is seen of a sheet's border in a frame, and what is known of the sheet from the frames before."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.frame import FARTHEST, readable_depth
from shape_obs.geometry.coons import FINE, RIM, SIDE, TURN_REACH, border_of, side_lengths
from shape_obs.geometry.curve import TrackHints
from shape_obs.geometry.outline import material_outline
from shape_obs.geometry.polyline import arc_length, laid_over
from shape_obs.image.region import Region
from shape_obs.initialization.corners import Rim, nearest_corners, rim_of
from shape_obs.tracking.corner_matching import assign_corners
from shape_obs.tracking.hidden_border import Border, complete_border, look_around
from shape_obs.tracking.prediction import Prediction

if TYPE_CHECKING:
    from shape_obs.camera import Intrinsics
    from shape_obs.configurations.base import Scene

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

# A side may be so much longer or shorter than it is known to be: as a share, without depth and with it, and in pixels.
# What is known follows by so much in a frame, without depth and with it; without depth all sides together may grow and
# shrink faster, as the sheet comes nearer.
_SLACK: Final = ((0.04, 0.07), 2.0)
_STRETCH: Final = (0.0022, 0.001)
_ZOOM: Final = 0.03
# Without depth, what hides a part is seen by a turn of the outline where it did not turn before, in radians: a sheet
# that bends on a table has none, but its corners are sheared.
_CHORD: Final = 3  # points of a border to either side, over which it is seen to turn
_CUT: Final = np.where(np.abs((np.arange(4 * SIDE) + SIDE // 2) % SIDE - SIDE // 2) <= _CHORD, 0.6, 0.38)
# Without depth, a border that lies off its known form by so much, as a share of a side and in pixels, is not its own;
# and the known form follows by this share.
_DENTED: Final = (0.035, 1.5)
_FORGETTING: Final = 0.03
_DOUBTED: Final = (0.3, 1.0)  # what lies farther from the known form, as a share of a gap and in pixels, is hidden
_STEADY: Final = 0.5
_LOCAL: Final = 2.5  # median distances: what lies off by less has bent with the rest of the sheet
_BUCKLED: Final = 0.8  # of its length a side that has buckled measures at least
_THROUGH: Final = 0.02  # of a sheet: the border of what is put back may lie a little outside
_BEHIND: Final = 0.01  # metres: what lies farther behind a sheet would be hidden by it
_INNER: Final = 0.06  # of the width: so far inside of its border the sheet's own plane is measured
_KINK: Final = 0.45  # radians: a border turns so much within the sheet at a fold, and nowhere else but at a corner
# Of half a diagonal, by which a corner may stray from where the others put it in a frame, and of the way, by which a
# border may stray from its form: without depth, and with it, where tilt and perspective are no evidence.
_ASTRAY: Final = (0.035, 0.12)
_ASIDE: Final = (0.05, 0.12)


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

    @classmethod
    def of(cls, region: Region, scene: Scene) -> SheetView:
        """Return the outline of a region, in space if the frame has depth along it."""
        outline = material_outline(region.outline.traced, False)[1]
        rim, turn, candidates, step, grain = rim_of(outline)
        lifted, cut = look_around(region, rim, scene.depth, scene.intrinsics, scene.edge)
        space, camera = (rim, None) if lifted is None else (lifted, scene.intrinsics)
        return cls(region, rim, turn, candidates, step, grain, space, cut, camera)

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
        readable, unit = readable_depth(depth)
        column, row = np.rint(lattice).astype(np.int64).T
        within = (row >= 0) & (row < readable.shape[0]) & (column >= 0) & (column < readable.shape[1])
        behind = np.zeros(len(patch))
        behind[within] = readable[row[within], column[within]] * unit
        through = (behind < FARTHEST) & (behind > patch[:, 2] + _BEHIND)
        return float(np.mean(through & ~self.region.carries(lattice))) > _THROUGH

    def turns_in_sheet(self, depth: npt.NDArray[Any]) -> Array:
        """Return ``(400,)`` radians by which the outline turns within the sheet, which bending does not change.

        A border that bends out of the sheet's plane turns in the image and not within the sheet; a fold's edge does.
        """
        back, ahead = np.roll(self.rim, TURN_REACH // 2, axis=0), np.roll(self.rim, -TURN_REACH // 2, axis=0)
        along = ahead - back
        inwards = np.stack([-along[:, 1], along[:, 0]], axis=1)
        inwards /= np.maximum(np.linalg.norm(inwards, axis=1, keepdims=True), 1e-9)
        inner = self.rim + _INNER * self.region.width * inwards
        lifted = look_around(self.region, np.ascontiguousarray(inner), depth, self.camera, None)[0]
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

    def corners_near(self, prediction: Prediction) -> Indices | None:
        """Return ``(4,)`` the corners nearest to the predicted ones; None if they are not in order."""
        expected = prediction.nodes[[0, FINE - 1, FINE * FINE - 1, FINE * (FINE - 1)]]
        found = nearest_corners(self.rim, self.candidates, self.step, np.ascontiguousarray(expected))
        return found if len(found) else None


@dataclass(frozen=True, eq=False)
class KnownSheet:
    """What is known of a sheet.

    Args:
        expected: ``(96, 2)`` pixels, its border where it is predicted.
        lattice: ``(625, D)`` the sheet as it was, wherever it lay, in metres if that is known, else in pixels.
        sides: ``(4,)`` the lengths of its sides in the same unit.
        hints: What the track stores.
    """

    expected: Array
    lattice: Array
    sides: Array
    hints: TrackHints

    @classmethod
    def of(cls, prediction: Prediction, view: SheetView) -> KnownSheet:
        """Return what a track knows, in metres if it does and this frame can be compared with that."""
        expected, hints = border_of(prediction.nodes), prediction.hints
        if hints.reference is None or hints.sides is None or (hints.reference.shape[1] == 3 and view.camera is None):
            return cls(expected, prediction.nodes, side_lengths(expected), hints)
        return cls(expected, hints.reference, hints.sides, hints)

    @property
    def metric(self) -> bool:
        """Whether lengths are metres."""
        return self.lattice.shape[1] == 3

    def slack(self, view: SheetView) -> Array:
        """Return ``(4,)`` by how much a side may be off."""
        share, pixels = _SLACK
        return np.maximum(share[self.metric] * self.sides, pixels * (view.scale if self.metric else 1.0))

    def conflict(self, view: SheetView, patch: Array, lattice: Array, *, buckled: bool = False) -> str:
        """Return what of a sheet that was found does not fit to what is known, or nothing.

        Args:
            view: The outline.
            patch: ``(625, D)`` the lattice as it lies.
            lattice: ``(625, 2)`` the same in pixels.
            buckled: Whether sides may be shorter, since nothing lies over them that could hide a part.
        """
        border, known = border_of(patch if self.metric else lattice), border_of(self.lattice)
        if not self.metric and (np.abs(_turns(border) - _turns(known)) < _CUT).all():
            return ""
        lengths = side_lengths(border)
        off = (lengths / self._zoom(lengths) - self.sides) / self.slack(view)
        if buckled:
            off[(off < 0) & (lengths > _BUCKLED * self.sides)] = 0.0
        side = int(np.argmax(np.abs(off)))
        if abs(off[side]) > 1:
            how = "shorter" if off[side] < 0 else "longer"
            return f"side {side} is {how} than it was: something hides a part of the sheet"
        if not self.metric:
            away = border - laid_over(known, border, known, scaled=True)[0]
            share, pixels = _DENTED
            if np.sqrt((away**2).sum(axis=1).max()) > pixels + share * self.sides.mean():
                return "a side is not where it was: something hides a part of the sheet"
        return ""

    def _zoom(self, lengths: Array) -> float:
        """Return by how much all sides have become longer; what hides a part shortens two or three of them."""
        if self.metric:
            return 1.0
        return float(np.clip(np.sort(lengths / self.sides)[2], 1 - _ZOOM, 1 + _ZOOM))

    def learn(self, view: SheetView, patch: Array) -> TrackHints:
        """Return what is known after a frame in which the whole border was seen, ``(625, D)`` as it lies."""
        if self.hints.reference is None or self.hints.reference.shape[1] < patch.shape[1]:
            return first_known(patch)
        if self.hints.reference.shape[1] > patch.shape[1]:  # a frame without depth adds nothing
            return self.hints
        lengths = side_lengths(border_of(patch))
        sides = self.sides * self._zoom(lengths)
        stretch = _STRETCH[self.metric] * sides
        sides = sides + np.clip(lengths - sides, -stretch, stretch)
        if self.metric:
            return TrackHints(reference=patch, sides=sides)
        laid = laid_over(self.lattice, patch, self.lattice, scaled=True)[0]
        step = patch - laid
        square = (step**2).sum(axis=1, keepdims=True)
        limit = max(_LOCAL**2 * float(np.median(square)), _STEADY**2)
        step *= _FORGETTING * np.minimum(limit / np.maximum(square, limit), 1.0) ** 2
        most = _STRETCH[True] * sides.mean()
        return TrackHints(reference=laid + np.clip(step, -most, most), sides=sides)

    def doubtful(self, patch: Array, gap: float) -> npt.NDArray[np.bool_]:
        """Return which points of a lattice ``(625, 2)`` are not where the known form has them, without depth.

        Something may lie over a border there that hides too little to be noticed by the border alone.

        Args:
            patch: The lattice as it lies.
            gap: Between two points that are asked for, pixels.
        """
        far = np.linalg.norm(patch - laid_over(self.lattice, patch, self.lattice, scaled=True)[0], axis=1)
        near = far <= max(_LOCAL * float(np.median(far)), _DOUBTED[1])
        far = np.linalg.norm(patch - laid_over(self.lattice[near], patch[near], self.lattice, scaled=True)[0], axis=1)
        share, pixels = _DOUBTED
        return far > max(share * gap, pixels, _LOCAL * float(np.median(far)))

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
        return self.hints._replace(sides=self.sides * np.clip(share, 1 - _STRETCH[True], 1 + _STRETCH[True]))

    def complete(self, view: SheetView, depth: npt.NDArray[Any] | None) -> Border | None:
        """Return the whole border, put back where it is hidden; None if too little of it is seen."""
        space = view.space if self.metric else view.rim
        arc, slack = arc_length(_closed(space)), self.slack(view)
        places = view.candidates[~view.cut[view.candidates]]
        expected = np.ascontiguousarray(self.expected[::SIDE])
        at, astray = np.ascontiguousarray(view.rim[places]), _ASTRAY[self.metric]
        found, cost = assign_corners(expected, at, arc[places], float(arc[-1]), self.sides, slack, astray)
        if not np.isfinite(cost):
            return None
        corners = np.where(found >= 0, places[found], -1)
        kinks = np.zeros(RIM, bool)
        if self.metric and depth is not None:
            turns = np.abs(view.turns_in_sheet(depth)) > _KINK
            near = np.abs((np.arange(RIM) - corners[corners >= 0][:, None] + RIM // 2) % RIM - RIM // 2) <= TURN_REACH
            kinks = turns & ~near.any(axis=0)
        known = border_of(self.lattice)
        pattern = self.expected if self.metric else known
        aside = _ASIDE[self.metric]
        return complete_border(pattern, known, view.rim, space, corners, view.cut, kinks, self.sides, slack, aside)


def first_known(patch: Array) -> TrackHints:
    """Return what is known of a sheet that was seen once, ``(625, D)`` as it lay."""
    return TrackHints(reference=patch, sides=side_lengths(border_of(patch)))


def _closed(points: Array) -> Array:
    return np.ascontiguousarray(np.concatenate([points, points[:1]]))


def _turns(border: Array) -> Array:
    """Return ``(96,)`` radians by which a border ``(96, 2)`` turns about each of its points."""
    at = border[:, 0] + 1j * border[:, 1]
    ahead, back = at[_AHEAD] - at, at - at[_BACK]
    return np.angle(ahead * back.conj())


_AHEAD: Final = (np.arange(4 * SIDE) + _CHORD) % (4 * SIDE)
_BACK: Final = (np.arange(4 * SIDE) - _CHORD) % (4 * SIDE)
