"""Pair colour images with the depth images of the same moment."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import Any, Final, NamedTuple

#: Largest number of colour images that wait for their depth. Bags store messages as they arrived, and depth may take
#: some frames longer; what waits longer has no depth.
_PENDING: Final = 30
#: Added to half a frame, in seconds: stamps jitter.
_JITTER: Final = 0.001


class Image(NamedTuple):
    """An image message and when it was taken.

    Attributes:
        number: How many images of its topic came before.
        stamp: Seconds of the camera's clock.
        message: The message.
    """

    number: int
    stamp: float
    message: Any


def half_interval(stamps: Sequence[float]) -> float:
    """Return half of the usual time between frames in seconds, with a margin for jitter, from some stamps."""
    steps = sorted(after - before for before, after in pairwise(stamps) if after > before)
    return (steps[len(steps) // 2] / 2 if steps else 0.5) + _JITTER


def pair_images(
    images: Iterable[tuple[bool, Image]], max_gap: float, gaps: list[float] | None = None
) -> Iterator[tuple[Image, Image]]:
    """Yield each colour image with the depth image that is nearest in time; one without such a depth is left out.

    Args:
        images: Colour and depth images as they arrived; True for depth.
        max_gap: Largest time between the two in seconds.
        gaps: Filled with the gap of each colour image to its nearest depth image; None if not needed.
    """
    colours: deque[Image] = deque()
    depths: deque[Image] = deque()

    def match(colour: Image) -> Iterator[tuple[Image, Image]]:
        nearest = min(depths, key=lambda depth: abs(depth.stamp - colour.stamp), default=None)
        if nearest is None:
            return
        gap = abs(nearest.stamp - colour.stamp)
        if gaps is not None:
            gaps.append(gap)
        if gap <= max_gap:
            yield colour, nearest
        while depths and depths[0].stamp < colour.stamp - max_gap and depths[0] is not depths[-1]:
            depths.popleft()

    for is_depth, image in images:
        (depths if is_depth else colours).append(image)
        while colours and ((depths and depths[-1].stamp >= colours[0].stamp) or len(colours) > _PENDING):
            yield from match(colours.popleft())
        while len(depths) > _PENDING:
            depths.popleft()
    for colour in colours:
        yield from match(colour)
