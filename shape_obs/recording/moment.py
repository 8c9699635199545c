"""Moment: a frame with what its source tells beside it; and the one loop that reads sources."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from shape_obs.frame import Frame
from shape_obs.source import EndOfSource, RGBDSource


class Moment(NamedTuple):
    """What a source told at one instant.

    Attributes:
        frame: What the camera saw.
        anchors: Where the object was held then: name -> base-frame point (x, y, z) in metres, or pixel (u, v). Sources
            that know publish them as ``anchors``, as environments do.
        episode: Counts the stretches between which the scene may have jumped: the episodes of an environment. Sources
            that have any publish it as ``episode``.
    """

    frame: Frame
    anchors: Mapping[str, Sequence[float]] = {}
    episode: int = 0


def read_moment(source: RGBDSource, timeout: float) -> Moment:
    """The next frame of a source, with what it tells beside it; errors as those of ``source.read``."""
    frame = source.read(timeout)
    return Moment(frame, dict(getattr(source, "anchors", {})), getattr(source, "episode", 0))


def read_moments(
    source: RGBDSource, frames: int | None = None, seconds: float | None = None, patience: float = 20.0
) -> Iterator[Moment]:
    """The moments of a source, until it ends.

    Args:
        source: Is connected where it is not.
        frames: How many at most.
        seconds: By the stamps, from the first one; its end is not included.
        patience: Seconds to wait for a frame; longer than a camera that stopped takes to come back.

    Raises:
        ValueError: ``seconds`` of a source whose frames have no stamps, or a limit that is none.
        SourceError: As ``source.connect`` and ``source.read``.
    """
    if frames is not None and frames < 1:
        raise ValueError(f"frames: expected 1 or more, got {frames}.")
    if seconds is not None and not seconds > 0:
        raise ValueError(f"seconds: expected more than 0, got {seconds}.")
    source.connect()
    begin, count = None, 0
    while frames is None or count < frames:
        try:
            moment = read_moment(source, patience)
        except EndOfSource:
            return
        stamp = moment.frame.stamp
        if seconds is not None:
            if stamp is None:
                raise ValueError(f"{source.name}: its frames have no stamps, so seconds mean nothing: give frames.")
            begin = stamp if begin is None else begin
            # Half a millisecond: sums of floating-point steps must not add a frame.
            if stamp - begin > seconds - 5e-4:
                return
        yield moment
        count += 1
