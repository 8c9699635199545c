"""The constants of the tracker, one record for each kind of shape, which every step takes as an argument.

A record is passed and not read from the module, so that another value needs no compiling::

    Centerline.model = replace(Centerline.model, velocity_share=0.9)

``python -m tests.benchmarks sensitivity`` halves and doubles each (docs/benchmarks/sensitivity.md); the formulas
are in docs/concepts/model.md. Of two values, the first is for images and the second for space, unless their line
differs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled

Model = npt.NDArray[Any]
_Pair = tuple[float, float]


@dataclass(frozen=True)
class MotionModel:
    """How any object moves and changes."""

    velocity_share: float = 0.8  # of a velocity between two frames, with which a shape goes on for as long
    max_size_change: float = 0.06  # of the size: a fit that differs by more is compared with one from an initial form
    max_width_change: float = 0.6  # of the width in a second
    longest_interval: float = 0.1  # s: a frame counts for no longer, though none was seen before it
    width_noise: float = 0.03  # of the width: smaller changes are noise
    steady: float = 0.003  # of the area, by which what is seen as a whole changes from frame to frame
    max_off: float = 0.10  # of a form: so much of it may be off the mask or cloud
    min_seen: float = 0.3  # of an object: so much has to be in sight to report it
    nearer: float = 0.008  # metres: what is nearer than an object by more, besides its slope, is over it

    @cached_property
    def record(self) -> Model:
        """``(1,)`` the same as compiled code takes it."""
        out = np.zeros(1, _record_type(type(self)))
        for each in fields(self):
            out[each.name] = getattr(self, each.name)
        return out


@dataclass(frozen=True)
class ChainModel(MotionModel):
    """A rope.

    The first value of ``length_tolerance``, ``tip_reach`` and ``at_border`` is a share of the length or of the width,
    the second is in resolutions or pixels. Those of ``tip_noise`` and ``any_cut`` are for how full the last square of a
    rope is, and for the tangent of the angle by which its end is oblique.
    """

    # Nodes.
    node_spacing: float = 1.4  # widths: closer, and a chain starts to fold; farther, and it cuts corners
    thinnest: float = 3.0  # pixels: nodes as near as a thinner rope is wide follow its staircase
    min_aspect: float = 3.0  # length over width: what is stouter has no distinct axis
    sigmas_initial: tuple[float, float, float] = (0.8, 0.4, 0.4)  # nodes: width of the neighbourhood in each epoch
    sigmas_steady: _Pair = (0.8, 0.4)  # nodes: the same of a track
    sigmas_changed: tuple[float, float, float, float] = (1.2, 0.6, 0.4, 0.4)  # nodes: where the area has changed
    more_pixels: float = 2.5  # times as many pixels as the rope: it does not come so much nearer in a frame
    whole_length: float = 0.03  # of a length in metres, by which the curve of a whole rope may be off

    # Measure.
    least_depth: float = 0.3  # of a curve's points, that need depth for a length in metres
    off_axis: float = 0.7  # widths in space: a sample farther from the axis has depth of what is behind it too
    least_overhang: float = 0.5  # pixels, by which the outline of an oblique end may reach beyond the axis

    # Evidence at the tips.
    tip_noise: _Pair = (0.25, 1.2)  # standard deviation of how a tip looks, times the width in pixels
    any_cut: _Pair = (0.1, 0.6)  # standard deviation of how a cut looks
    unfamiliar: float = 4.0  # times: how much larger the variance of a tip is that was seen once
    tip_reach: _Pair = (1.5, 8.0)  # widths and pixels around a tip in which what hides it must be
    at_border: _Pair = (0.5, 2.0)  # widths and pixels from the border, within which a rope is cut off by it
    level: float = 0.004  # metres: what goes on at the rope's own depth, within this and noise, is the rope
    depth_sigmas: float = 2.0  # standard deviations of a D455's depth, by which a surface may seem to be off
    touching: float = 0.06  # of the pixels ahead: that many are nearer where something hides the rope
    seen_past: float = 0.5  # of the pixels ahead: that many are behind a tip that is free
    goes_on: float = 0.7  # of the pixels straight ahead that show the rope's own surface
    tip_base: _Pair = (1.0, 2.5)  # widths before a tip, between which the direction of the axis is taken

    # Register: what is missing.
    length_noise: _Pair = (0.3, 0.9)  # resolutions: noise of a length, and what foreshortening by half adds to it
    length_tolerance: _Pair = (0.01, 1.5)  # of the length and in resolutions: what is missing below this is noise
    least_missing: float = 0.002  # of a length in pixels: less cannot be seen to be missing
    pointing: float = 3.0  # times as long in space as in the image: there a tip hides what goes on behind it
    beyond_noise: float = 4.0  # standard deviations of a length, beyond which noise explains nothing
    seems_short: float = 1.5  # standard deviations by which a rope is too short, and its tips may be cut
    by_noise: float = 1.0  # standard deviations of a length, which may seem hidden
    evenly: float = 0.1  # weight of a piece at a right angle to the view, in a length that is off
    evidence_memory: float = 0.15  # s: how long evidence for cut tips is kept
    independent_after: float = 0.033  # s: frames closer in time see the same tips, and count in proportion
    certain: float = 8.0  # nats: the most that such evidence can weigh
    sure: float = 5.0  # nats at which the look of a tip decides, or a remembered form: 1 in 150 may be wrong
    hold: float = 0.11  # s, for which an end is taken for hidden after something was seen to hide it
    still_missing: float = 0.5  # of what was hidden: an end is only taken for hidden if so much is missing
    gap_drift: float = 0.1  # of a bridged gap: by so much what is behind it may have moved into it
    lost_after: float = 0.18  # s without the rope, after which it may have moved along itself by any length

    # Register: direction.
    far_along: float = 0.16  # of the length: no rope that is seen in part slides so far between two frames
    clear: float = 3.0  # times: how much nearer ends are to their own places than to each other's
    unseen: float = 15.0  # nats, for a piece where all was folded back
    sure_direction: float = 4.0  # nats by which the other one has to be less likely; at 5, more ropes are lost
    uncovering: float = 2.0  # 1/s: how often an end goes out of sight or comes to light

    # Register: placements.
    independent: _Pair = (4.0, 1.0)  # of 32 errors, in form and in place: neighbours err alike
    perfect: float = 0.15  # resolutions: how far off a curve is that was predicted perfectly
    motion_floor: float = 0.35  # resolutions: a rope at rest is not farther from its prediction
    trust: float = 5.0  # squared standard deviations, beyond which costs grow slowly: predictions may be far off
    cost_of_hiding: tuple[float, float, float] = (2.0, 0.5, 8.0)  # nats: of an unknown, hidden, free end
    hiding_rate: tuple[float, float, float] = (1.5, 3.0, 1.5)  # of the length in a second, of the same ends
    bridge: float = 0.35  # of a bridged gap: the standard deviation of its length
    too_short: float = 3.0  # standard deviations by which a length may be short, though an end is hidden
    first_speed: float = 30.0  # resolutions in a second: by so much predictions are off before any was tested
    speed_memory: float = 0.32  # s: how fast it is learnt by how much they are
    outlier: float = 10.0  # times the usual squared distance: more is not learnt from at once

    # Learn.
    first_spread: _Pair = (0.003, 0.006)  # of a length in pixels and in metres, before any was measured
    length_spread: _Pair = (0.001, 0.012)  # of the length: its spread at least, and in metres at most
    memory: float = 0.65  # s: how fast length, its spread and the look of tips are learnt
    length_rate: float = 0.03  # of the length in a second, by which it follows what noise does not explain
    shorter: _Pair = (1.5, 2.0)  # standard deviations by which a length is learnt to be shorter
    shorter_for: float = 1.0  # s, for which a rope with free tips is shorter: it has changed

    # Complete.
    gap_stretch: float = 1.3  # times: a gap that is so much wider or narrower than predicted stays straight
    long_end: float = 0.06  # of the length: next to a hidden end that is shorter, the visible piece stays as it is
    turn: float = 0.06  # of the length, at most: so much next to what is behind the rope is off by up to 2 gaps of 20
    levelling: float = 0.32  # s: how fast what is hidden becomes as deep as what is seen next to it
    next_to: float = 0.25  # of the visible piece, next to a hidden end, whose scale that end has
    along_cut: float = 0.6  # widths of the visible piece next to a hidden end, which may follow the cut

    # Judge. The limits of steepness and shortness are from 40,000 frames of swung ropes and 7,900 under shadows.
    max_hidden: float = 0.75  # of a tracked rope: so much of it may be out of sight
    max_drift: float = 0.02  # of the length: by so much a rope may have moved along itself unseen
    max_scatter: float = 0.40  # widths: RMS distance of what is seen from the curve; of an ideal ribbon 0.29
    min_stretch: float = 0.957  # a curve that became longer by more follows something else; a pulled band does not
    max_misplaced: float = 0.2  # of a curve, that lies where a far part of the rope was expected
    either_end: float = 0.08  # of the length: if so much more may be hidden at the other end, neither is known
    min_in_pieces: float = 0.45  # the same around a long gap: a piece behind it may be anywhere
    long_gap: float = 0.1  # of the length
    min_between: float = 0.6  # of the length: so much has to be in sight while both ends are hidden
    min_followed: float = 0.15  # of the length: with less in sight, the track stays where it was
    max_foreshortening: float = 4.0  # times as long in space as in the image: its points cannot be told apart there
    most_oblique: float = 2.7  # the same at the other tip, if one end is hidden
    oblique_cut: float = 2.0  # the same where that tip looks cut rather than the hidden end does
    most_missing: float = 0.016  # of the length, while both ends point at the camera
    steepest: float = 6.0  # times as long in space as in the image, while a tip does not look like the rope's own
    short_tolerances: float = 1.4  # tolerances by which a length in metres may be too short


@dataclass(frozen=True)
class OutlineModel(MotionModel):
    """What is the same for outlines and for the outlines of sheets."""

    at_edge: float = 0.8  # pixels: an outline as near to the edge of what is searched is cut off by it
    depth_reach: float = 0.125  # of the width: depth along an outline is read within this
    min_reach: float = 2.0  # pixels: that reach at least
    max_reach: float = 5.0  # pixels: that reach at most
    min_depth: float = 0.5  # of the pixels around a point: with less depth, a plane through them is off next to a hole
    edge_reach: float = 7.0  # pixels beyond an outline, where depth is looked for: a camera has none next to an edge
    form_noise: float = 0.5  # pixels: what is nearer to the known form is off by noise


@dataclass(frozen=True)
class RingModel(OutlineModel):
    """An outline."""

    # Nodes. At 4 px they jitter by a sixth more than at 6 px; at 8 px garments are 0.16 px off instead of 0.13.
    node_spacing: float = 3.0  # samples from node to node: closer, they follow the pixels; farther, they cut corners
    max_spacing: float = 1.5  # widths from node to node: farther, and a node's samples are those of the other side too
    min_width: float = 1.25  # samples: of outlines of 2 px, one in three has its two sides mixed up; of 3 px, none
    min_hollow: float = 0.05  # of what a closed band encloses; drawn shapes without a hole have at most 0.01
    sigma: float = 0.4  # nodes: width of the neighbourhood; there is one epoch, since the start is on the outline

    # Register.
    start_weight: float = 0.05  # of a match of forms: weight of the place; of a square's four ways the nearest is taken
    place_weight: _Pair = (0.0003, 1.0)  # the same on a circle: of any size, and times a squared resolution, for noise
    staircase: float = 0.06  # squared resolutions: what the staircase of pixels makes of a circle
    outlier: float = 2.0  # median distances: what is farther off has bent or is hidden, and counts for little

    # Learn. Numbered by the last frame alone, an outline of noisy pixels drifts by 6 px in 180 frames.
    outline_memory: float = 0.65  # s: how fast the known outline follows the one that is found
    max_outline_change: float = 0.09  # of the radius in a second: what a hand hides slowly is not forgotten

    # Hidden pieces, and how they are completed.
    inside: float = 1.2  # pixels: an outline so far within the known one is not the object's own
    cut_turn: float = 0.28  # radians by which it turns more than the known one where something begins to hide it
    may_cut: float = 0.4  # of that turn: with less between its nodes, nothing hides a piece
    turn_reach: float = 1 / 16  # of the outline to either side: a turn is measured over it
    turn_within: float = 3.0  # nodes from where it leaves the known outline to that turn, at most
    trimmed: float = 4.0  # points of a visible piece next to what hides the rest, which are not used
    min_seen: float = 0.4  # of the outline: so much has to be in sight, in one piece
    place_cost: float = 0.005  # of a misfit of forms: what a misfit of places costs

    # Judge. The staircase of pixels alone is 0.12 samples off the best curve, flipped border pixels twice that.
    miss: _Pair = (0.15, 0.75)  # samples by which an outline misses the mask's: of an ideal one, and at most
    min_piece: float = 0.6  # of the object: the largest piece


@dataclass(frozen=True)
class LatticeModel(OutlineModel):
    """A sheet."""

    # Which objects are sheets.
    min_width: float = 6.0  # resolutions: what is narrower has no two sides that can be distinguished
    max_aspect: float = 8.0  # length over width: what is longer is a ribbon, whose corners are its ends
    max_cut: float = 0.03  # of the outline, which may be on the image's edge when a track begins
    min_piece: float = 0.8  # of the mask: the largest piece, since a sheet cannot be connected over a gap

    # Register: which turns of the outline are corners. Standard deviations are those of a frame.
    corner_reach: float = 0.8  # half diagonals from where a corner is expected: it is not looked for farther off
    corner_spread: _Pair = (0.035, 0.12)  # half diagonals: of one from where the others put it; tilt moves it in space
    shift_spread: float = 0.3  # half diagonals: standard deviation of the motion of all corners
    scale_spread: float = 0.15  # standard deviation of the logarithm of their scale
    cost_of_hiding: float = 1.5  # nats: of a hidden corner
    cost_of_detour: float = 1.0  # nats: at most, of a long side with something over its middle

    # Register: sides, and what hides a part of them.
    length_tolerance: _Pair = (0.04, 0.07)  # of a side: its length may be off by so much
    border_noise: float = 2.0  # pixels: a length and a border may be off by so much
    max_zoom: float = 0.03  # of the size, in a frame: all sides in an image grow and shrink together
    cut_turn: _Pair = (0.38, 0.6)  # radians by which a border turns where something hides it: on a side; at a corner
    dent: _Pair = (0.035, 1.5)  # of a side and pixels: what is farther from a border's form is not its own
    outlier: float = 2.5  # median distances: what is nearer to the known form has bent with the rest of the sheet
    hidden_place: _Pair = (0.3, 1.0)  # of a gap and pixels: nodes in an image farther from the known form are hidden

    # Complete.
    border_bend: _Pair = (0.05, 0.12)  # of the way from a corner: a border is followed while it is no farther off
    own_length: float = 2.0  # tolerances: a side that is off by less between two corners in sight is all its own
    trimmed: float = 1.0  # points of a border before it leaves its form, and next to a corner, which are not used
    max_misfit: float = 0.06  # of the size: RMS distance of what is seen of a border from the known one
    max_seen_through: float = 0.02  # of a sheet, behind which depth is seen: what is put back may be a little outside
    inner: float = 0.06  # of the width from its border: there the plane of a sheet is measured
    fold_turn: float = 0.45  # radians by which a border turns within the sheet at a fold, and else at corners alone

    # Learn.
    max_stretch: _Pair = (0.066, 0.03)  # of a side in a second: its known length follows by so much
    form_memory: float = 1.1  # s: how fast the known form follows in an image

    # Judge a lattice. Of real towels no side turns by more than 36 degrees or winds by more than 7 %, and no areas vary
    # by more than 15 %; T-shirts and shorts begin there.
    max_skew: float = 55.0  # degrees by which a corner may miss a right angle
    kink: _Pair = (25.0, 60.0)  # degrees by which a side turns: in wrinkles, and at most
    max_winding: float = 0.20  # of the way from corner to corner: excess length of a side
    max_uneven: float = 0.40  # variation of the areas of cells
    max_unequal: float = 0.03  # of a gap in space: mean difference; of 1,663 drawn frames with less, 3 are wrong
    gap_noise: float = 0.8  # errors of a point: mean difference of gaps that noise explains

    # Judge by depth whether it is folded or crumpled (``tests.benchmarks sheets.crumpled``). Of 170 simulated cloths
    # that were dropped, dragged and folded, all within these shares were at most half a cell off on average; of 60 in
    # waves one was not within them, under 2 mm of noise.
    flying: float = 2.0  # pixels from the border, whose depth may be between the sheet's and that of what is behind
    smeared: float = 3.0  # pixels from the border, whose depth may be that of what is behind
    step: float = 0.005  # metres between two samples: two layers of a towel, 5 times a D455's noise at 0.7 m
    step_slope: float = 1.5  # metres of depth for each metre: steeper than any crease of a cloth in waves (1.0)
    step_noise: float = 4.0  # times the median of the largest steps of all gaps, which is noise
    fall_noise: float = 2.0  # times the same: a smaller fall at a border may be noise
    steep: float = 0.55  # radians by which a surface leans at its border, where it may turn away
    steeper: float = 0.4  # radians by which it leans more there than an eighth of a side farther in
    row_noise: float = 0.03  # of the median length of rows: a difference that noise and waves explain
    max_short: float = 0.18  # of the median length: how much shorter a row may be along the surface
    max_long: float = 0.5  # of the median length: how much longer
    torn: _Pair = (0.25, 0.4)  # of the rows in which depth steps: what noise and waves explain, and at most
    turned: _Pair = (0.2, 0.3)  # of a side that turns away: what noise and waves explain, and at most
    min_flat: float = 0.5  # of 1, a sheet that is spread out: shares that are near their limits add up
    node_noise: float = 0.1  # of a gap: nodes that may be off by less are not
    uncertain: float = 0.2  # of a gap, beyond that: nodes that may be off by more are uncertain


@compiled
def gain_of(seconds: float, memory: float) -> float:
    """Return the weight of a new value in a mean that fades with a time constant, after some seconds."""
    return 1 - math.exp(-seconds / memory)


def _record_type(kind: type[MotionModel]) -> np.dtype[Any]:
    """Return the type of a model's record; of several values each, an array."""
    model = kind()
    shapes = {each.name: np.shape(getattr(model, each.name)) for each in fields(kind)}
    return np.dtype([(name, "f8", shape) for name, shape in shapes.items()], align=True)


#: The type of a ``ChainModel``'s record.
ChainConstants: Final = _record_type(ChainModel)
#: The type of a ``RingModel``'s record.
RingConstants: Final = _record_type(RingModel)
#: The type of a ``LatticeModel``'s record.
LatticeConstants: Final = _record_type(LatticeModel)
