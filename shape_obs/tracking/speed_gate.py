"""The speed gate: what lies farther away than an object can have moved is another one, unless its path joins up.

The allowance is ``max_speed`` times the seconds since the last *accepted* frame, measured from where the object was and
from where its motion takes it. What lies beyond it becomes a candidate, which is tracked like any other object. The
allowance does not grow for a candidate: what was seen elsewhere does not come within reach by waiting.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled
from shape_obs.frame import DEPTH_TYPE, DepthImages
from shape_obs.image.over_under import depth_at
from shape_obs.tracking.model import MotionModel
from shape_obs.tracking.predict import Fit, Prediction, Track, predict
from shape_obs.tracking.scene import Scene

Array = npt.NDArray[np.float64]

_ASKED: Final = 64  # nodes of a form and of the track that are compared
_CONTINUOUS: Final = 5  # frames for which a candidate moves continuously before it is believed
_LONGEST: Final = 10  # frames in which an object in plain sight is refused, at most
WHOLE: Final = 0.94  # of the known size: what is smaller may be a piece of the object
_FALLING: Final = 0.03  # in a second: the same falls where the size is in pixels, since the object may be tilted
LARGER: Final = 2.0  # times: what is so much larger is not the object


class Candidate(NamedTuple):
    """What is seen where the object cannot be, and may be it all the same.

    Args:
        track: Its own.
        begun: When it was first seen, seconds.
        frames: For how many frames it has moved continuously.
        refused: For how many frames something in plain sight was refused before, this candidate or another one.
        joins: Whether it is numbered as the object is and, from its second frame on, could have come from there.
        own: Whether it is numbered as another object.
    """

    track: Track
    begun: float
    frames: int
    refused: int
    joins: bool
    own: bool

    def continued(self, track: Track) -> Candidate:
        """Return the candidate after another frame of its path."""
        return self._replace(track=track, frames=self.frames + 1, refused=self.refused + 1)

    def leads_to(self, found: Fit, gate: SpeedGate, scene: Scene) -> bool:
        """Return whether a fit continues its path."""
        if found.track is None or (found.reason and not found.follow):
            return False
        ahead = Prediction(self.track, scene.clock.now, gate.model)
        return not gate.exceeded(found.track.nodes, ahead, ahead.seconds, scene)

    @property
    def believed(self) -> bool:
        """Whether it is the object, or another one in its place."""
        return self.frames >= _CONTINUOUS or self.refused >= _LONGEST

    @property
    def joined(self) -> bool:
        """Whether its path could have joined the object's track within ``max_speed``."""
        return self.joins and self.frames > 0


def is_as_large(found: Fit, track: Track, now: float) -> bool:
    """Return whether a form is as large as the object that was tracked, and nothing of it is out of sight."""
    form, rope = found.form, track.rope
    known = 0.0 if rope is None or not len(form.metres) else float(rope["metres"][0])
    if known > 0:
        return form.whole and float(form.metres[-1]) >= WHOLE * known
    return form.whole and form.size >= (WHOLE - _FALLING * (now - track.stamp)) * track.size


class SpeedGate:
    """Compare how far an object has moved with how far it can have moved.

    Args:
        max_speed: Metres a second with depth and in clouds, image widths a second without; None for no limit.
        model: How objects move.
    """

    def __init__(self, max_speed: float | None, model: MotionModel) -> None:
        self._max_speed = math.inf if max_speed is None else max_speed
        self.model = model

    def exceeded(self, nodes: Array, ahead: Prediction, seconds: float, scene: Scene) -> str:
        """Return why nodes ``(K, D)`` are another object's than the one that was tracked; empty if they are not.

        Args:
            nodes: Of what was found.
            ahead: Where the object was, and where its motion takes it.
            seconds: For which it can have moved.
            scene: The frame.
        """
        before = ahead.track.nodes
        if math.isinf(self._max_speed) or nodes.shape[1] != before.shape[1]:
            return ""
        moved, most, scale, unit = self._compared(nodes, before, seconds, scene)
        if moved <= most or self._compared(nodes, ahead.nodes, seconds, scene)[0] <= most:
            return ""
        moved, most = moved * scale, most * scale
        return f"it lies {moved:.3g} {unit} from where the shape was (at most {most:.3g} after {seconds:.2g} s)"

    def joins(self, candidate: Candidate, first: Array, ahead: Prediction, scene: Scene) -> bool:
        """Return whether a candidate's path could have joined the object's track.

        What the candidate's motion explains is left out: something that stands still elsewhere has not come from here.

        Args:
            candidate: Seen twice, so that its velocity is known.
            first: ``(K, D)`` its nodes when it was first seen.
            ahead: Where the object was, and where its motion takes it.
            scene: The frame.
        """
        seconds, velocity = candidate.begun - ahead.track.stamp, candidate.track.velocity
        before = first - min(seconds, candidate.track.interval) * velocity
        return not self.exceeded(np.ascontiguousarray(before), ahead, seconds, scene)

    def reach(self, track: Track, scene: Scene) -> float:
        """Return how far an object can have moved, in the unit of its track; infinity if unknown."""
        most = self._max_speed * (scene.clock.now - track.stamp)
        if track.nodes.shape[1] == 3:
            return most
        if scene.intrinsics is None:
            return most * scene.size[1]
        if len(track.log_depth) == 0:
            return math.inf
        focal = scene.intrinsics.fx
        return most * focal / math.exp(track.log_depth.item(len(track.nodes) // 2) / focal)  # as deep as its middle

    def _compared(self, nodes: Array, before: Array, seconds: float, scene: Scene) -> tuple[float, float, float, str]:
        """Return how far nodes have moved and can have, in their unit, and this unit in pixels or metres, and which."""
        moved, away = typical_motion(nodes, before, scene.images)
        most, scale, unit = self._max_speed * seconds, 1.0, "m"
        if nodes.shape[1] == 2 and scene.intrinsics is not None and away > 0:
            scale = away / scene.intrinsics.fx
        elif nodes.shape[1] == 2:
            most, unit = most * scene.size[1], "px"
        return moved, most / scale, scale, unit


@compiled("(f8[:,::1], f8[:,::1], " + DEPTH_TYPE + ")")
def typical_motion(nodes: Array, before: Array, depth: DepthImages) -> tuple[float, float]:
    """Return the median distance of the nodes of a track to the nearest of a form's, and the median depth there.

    Args:
        nodes: ``(K, D)`` of the form; at most 64 of them are compared.
        before: ``(K', D)`` of the track; the same.
        depth: The frame's, see ``frame.depth_images``.

    Returns:
        In the unit of the nodes; metres, 0 where there is no depth.
    """
    step, stride = -(-len(nodes) // _ASKED), -(-len(before) // _ASKED)
    apart, away, known = np.empty(-(-len(before) // stride)), np.empty(len(nodes)), 0
    for k in range(0, len(before), stride):
        least = np.inf
        for j in range(0, len(nodes), step):
            square = 0.0
            for d in range(nodes.shape[1]):
                square += (nodes[j, d] - before[k, d]) ** 2
            least = min(least, square)
        apart[k // stride] = math.sqrt(least)
    for j in range(0, len(nodes), step):
        metres = depth_at(depth, nodes[j, 0], nodes[j, 1])
        if metres > 0:
            away[known] = metres
            known += 1
    return np.median(apart), np.median(away[:known]) if known else 0.0


TRACK_FUNCTIONS: Final = predict, typical_motion
