"""PairGate: which colour and depth images belong together."""

from __future__ import annotations

from typing import Final

#: Of a frame interval. Two cameras that run freely are half an interval apart at most, and a D455's nearly not at all;
#: a pair that is off by a whole frame is farther apart than this.
_GAP_SHARE: Final = 0.75


class PairGate:
    """Lets through pairs whose images are both new and of the same moment.

    When one stream stops, librealsense goes on pairing its last image with every new one of the other. Such a pair
    looks whole, and shows the past in one half.

    Args:
        interval: Seconds between frames.
        max_gap: Seconds that two images of a pair may be apart; None for three quarters of the interval.

    Attributes:
        refused: How many pairs in a row were refused up to now.
        reason: Why the last of them was.
    """

    def __init__(self, interval: float, max_gap: float | None = None) -> None:
        self._max_gap = _GAP_SHARE * interval if max_gap is None else max_gap
        self._last: tuple[int, int] | None = None
        self.refused, self.reason = 0, ""

    def admits(self, colour: int, depth: int, gap: float | None) -> bool:
        """Whether a pair is let through.

        Args:
            colour: Number of the colour frame.
            depth: Number of the depth frame.
            gap: Seconds between them; None where their clocks cannot be compared.
        """
        reason = self._objection(colour, depth, gap)
        if reason is not None:
            self.refused, self.reason = self.refused + 1, reason
            return False
        self._last, self.refused = (colour, depth), 0
        return True

    def _objection(self, colour: int, depth: int, gap: float | None) -> str | None:
        if self._last is not None and colour == self._last[0]:
            return "the colour image was an old one"
        if self._last is not None and depth == self._last[1]:
            return "the depth image was an old one"
        if gap is not None and gap > self._max_gap:
            return f"colour and depth were more than {1000 * self._max_gap:.0f} ms apart"
        return None
