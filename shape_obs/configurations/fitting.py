"""One shape, one frame: from a body and the past to a form and the present. Pure: the detector remembers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.configurations import Configuration
from shape_obs.configurations.base import Origin
from shape_obs.geometry.form import Curve, Form
from shape_obs.geometry.topology import Topology
from shape_obs.image.region import Region
from shape_obs.point_cloud.body import Body
from shape_obs.tracking.occluders import revealed
from shape_obs.tracking.prediction import Prediction, Track, advance, predict, size_jump
from shape_obs.tracking.validation import MAX_HIDDEN

Array = npt.NDArray[np.float64]

_MIN_SAMPLES: Final = 16
_STEADY: Final = 0.003  # of its area, by which a body that is seen as a whole changes from frame to frame


@dataclass(frozen=True)
class Fit:
    """A form found on a body.

    Args:
        form: In the order of the points; None when nothing was found.
        quality: 0...1.
        reason: Why it was refused; empty if it was not.
        centres: (N,D) the shape's points in order, where a clusterer has found them; None leaves them to the form.
        body: What it was fitted to, with what the past knows about it.
    """

    form: Form | None
    quality: float = 0.0
    reason: str = ""
    centres: Array | None = None
    body: Body | None = None

    @property
    def ok(self) -> bool:
        """Whether it passed the gate."""
        return not self.reason


def fit(
    body: Body,
    spec: Configuration,
    track: Track | None,
    target: Array | None,
    stamp: float,
    depth: npt.NDArray[Any] | None = None,
) -> tuple[Fit, Track | None]:
    """Find one shape: from the prediction while there is a track, else (or when that fails) from a cold start.

    Args:
        body: What was segmented.
        spec: What to look for.
        track: The past; None at the start. It orients a cold start too.
        target: Where point 0 belongs, as ``body.seen`` sees it; None for the top left.
        stamp: Seconds.
        depth: (H,W) the frame's depth, where there is one.

    Returns:
        The fit, and the track to remember (None when the fit was refused).
    """
    prediction = None if track is None else predict(track, stamp, body.grain)
    if prediction is not None and isinstance(body, Region):
        prediction = prediction._replace(depth=depth)
    known = body if prediction is None else spec.known(body, prediction)
    reason = _too_little(body) or spec.unfit(known)
    if reason:
        return Fit(None, reason=reason), None
    if prediction is None:
        topology = spec.topology(body)
        found = _numbered(_cold(body, spec, topology, None), body, spec, target)
    else:
        topology, origin = prediction.topology, _origin(body, prediction)
        found = _settle(spec.warm(known, prediction), known, spec, topology, origin, MAX_HIDDEN, prediction)
        if found.form is not None and found.ok:
            jump = size_jump(prediction.size, found.form.size, body.unit)
            found = replace(found, reason=jump) if jump else found
        if found.form is None or not found.ok:
            found = _cold(body, spec, topology, prediction)
        elif any(found.form.memory.hidden) and (
            _hidden(found.form) > sum(prediction.memory.hidden) + found.form.memory.slack
        ):
            # Something came over an end, or the chain lost its way there: a fresh start knows.
            again = _cold(body, spec, topology, prediction)
            better = again.ok and again.form is not None and _hidden(again.form) < _hidden(found.form)
            found = again if better else found
    if found.form is None or not found.ok:
        return found, None
    form = found.form
    if depth is not None and isinstance(form, Curve) and isinstance(body, Region) and _hidden(form) > form.memory.slack:
        form = revealed(form, depth, body.width)
        found = replace(found, form=form)
    nodes, width = spec.nodes(form, topology), spec.girth(form, body)
    box = body.box if isinstance(body, Region) else None
    present = advance(track, nodes, form, stamp, topology, width, box, body.amount)
    return (_numbered(found, body, spec, target) if spec.order == "image" else found), present


def _origin(body: Body, prediction: Prediction) -> Origin:
    """Whether all of the body was seen and is; what comes to light, or under a hand, changes its area first."""
    return "tracked" if abs(body.amount - prediction.amount) <= _STEADY * prediction.amount else "gap"


def _hidden(form: Form) -> float:
    return sum(form.memory.hidden)


def _too_little(body: Body) -> str:
    if not body.pieces:
        return f"the {body.noun} is empty"
    if body.amount < _MIN_SAMPLES:
        return f"the {body.noun} has {body.amount} {body.grains}, at least {_MIN_SAMPLES} are needed"
    return ""


def _cold(body: Body, spec: Configuration, topology: Topology, prediction: Prediction | None) -> Fit:
    """From the configuration's own start, turned to the prediction where there is one."""
    form = spec.parameterise(body)
    if form.doubt:
        return Fit(None, reason=form.doubt)
    if prediction is not None:
        form = spec.follow(form, prediction)
    start = spec.nodes(form, topology)
    return _settle(start, body, spec, topology, "cold", form.empty, prediction)


def _settle(
    start: Array,
    body: Body,
    spec: Configuration,
    topology: Topology,
    origin: Origin,
    bridged: float,
    prediction: Prediction | None,
) -> Fit:
    """Cluster, finish, follow the past, judge."""
    form = spec.settled(start, body, topology, origin)
    if prediction is not None:
        form = spec.follow(form, prediction)
    verdict = spec.judge(form, body, bridged)
    return Fit(form, verdict.quality, verdict.reason, body=body)


def _numbered(found: Fit, body: Body, spec: Configuration, target: Array | None) -> Fit:
    """The fit numbered by the paper's rule."""
    if found.form is None:
        return found
    seen = body.seen(found.form.points, target)
    return replace(found, form=spec.numbered(found.form, seen, target))
