"""The constants of the tracker, one record for each kind of shape, which every step takes as an argument.

A record is passed and not read from the module, so that another value needs no compiling::

    Centerline.model = replace(Centerline.model, velocity_share=0.9)

``python -m tests.benchmarks sensitivity`` halves and doubles each (docs/benchmarks/sensitivity.md); the formulas
are in docs/concepts/model.md. Of two values, the first is for images and the second for space, unless their line
differs.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Final

import numpy as np
import numpy.typing as npt

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
    nearer: float = 0.008  # metres: what is nearer than the rope by this much, and its slope, is over it
    level: float = 0.004  # metres: what goes on at the rope's own depth, within this, is the rope
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
    own_tip: float = 6.0  # nats: a tip that is so much likelier the rope's own than cut shows where the rope ends
    hold: float = 0.11  # s, for which an end is taken for hidden after something was seen to hide it
    still_missing: float = 0.5  # of what was hidden: an end is only taken for hidden if so much is missing
    slides: float = 0.1  # of a bridged gap: by so much what is behind it may have slid into it
    long_ago: float = 0.18  # s without the rope, after which it may have slid anywhere

    # Register: direction.
    clear: float = 3.0  # times: how much nearer ends are to their own places than to each other's
    unseen: float = 30.0  # squared standard deviations, for a piece where all was folded back
    uncovering: float = 2.0  # 1/s: how often an end goes out of sight or comes to light
    sure: float = 8.0  # squared standard deviations by which the other direction has to be less likely

    # Register: placements.
    independent: _Pair = (4.0, 1.0)  # of 32 errors, in form and in place: neighbours err alike
    perfect: float = 0.15  # resolutions: how far off a curve is that was predicted perfectly
    at_rest: float = 0.35  # resolutions: a rope at rest is not farther from its prediction
    trust: float = 5.0  # squared standard deviations, beyond which costs grow slowly: predictions may be far off
    cost_of_hiding: tuple[float, float, float] = (4.0, 1.0, 16.0)  # squared s.d.: an unknown, hidden, free end
    hiding_rate: tuple[float, float, float] = (1.5, 3.0, 1.5)  # of the length in a second, of the same ends
    cost_of_folding: float = 100.0  # squared standard deviations, of a free end while something hides the other
    bridge: float = 0.35  # of a bridged gap: the standard deviation of its length
    too_short: float = 3.0  # standard deviations by which a length may be short, though an end is hidden
    first_speed: float = 30.0  # resolutions in a second: by so much predictions are off before any was tested
    speed_memory: float = 0.32  # s: how fast it is learnt by how much they are
    outlier: float = 10.0  # times the usual squared distance: more is not learnt from at once

    # Learn.
    first_spread: _Pair = (0.003, 0.006)  # of a length in pixels and in metres, before any was measured
    length_spread: _Pair = (0.001, 0.012)  # of the length: its spread at least, and in metres at most
    followed_spread: float = 0.04  # of a length in pixels: if it varies so much, by perspective, it is followed at once
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
    max_drift: float = 0.02  # of the length: by so much a rope may have slid along itself unseen
    max_scatter: float = 0.40  # widths: RMS distance of what is seen from the curve; of an ideal ribbon 0.29
    min_stretch: float = 0.957  # a curve that became longer by more follows something else; a pulled band does not
    either_end: float = 0.08  # of the length: if so much more may be hidden at the other end, neither is known
    min_seen: float = 0.3  # of the length: so much has to be in sight to report it
    min_in_pieces: float = 0.45  # the same around a long gap: a piece behind it may be anywhere
    long_gap: float = 0.1  # of the length
    min_between: float = 0.6  # of the length: so much has to be in sight while both ends are hidden
    min_followed: float = 0.15  # of the length: with less in sight, the track stays where it was
    most_end_on: float = 4.0  # times as long in space as in the image: its points cannot be told apart there
    most_oblique: float = 2.7  # the same at the other tip, if one end is hidden
    oblique_cut: float = 2.0  # the same where that tip looks cut rather than the hidden end does
    most_missing: float = 0.016  # of the length, while both ends point at the camera
    steepest: float = 6.0  # times as long in space as in the image, while a tip does not look like the rope's own
    short_tolerances: float = 1.4  # tolerances by which a length in metres may be too short


def _record_type(kind: type[MotionModel]) -> np.dtype[Any]:
    """Return the type of a model's record; of several values each, an array."""
    model = kind()
    shapes = {each.name: np.shape(getattr(model, each.name)) for each in fields(kind)}
    return np.dtype([(name, "f8", shape) for name, shape in shapes.items()], align=True)


#: The type of a ``ChainModel``'s record.
ChainConstants: Final = _record_type(ChainModel)
