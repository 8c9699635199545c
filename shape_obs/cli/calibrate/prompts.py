"""Touches, asked for one by one."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from shape_obs.calibration import Touch, write_touches
from shape_obs.calibration.touch_points import CORNERS
from shape_obs.spec import SpecError


def ask_touches(markers: Sequence[int], keep: Path) -> list[Touch]:
    """Ask where the tool tip is at each corner of each marker.

    Args:
        markers: Their ids.
        keep: A CSV file that is written anew after each answer, so that none is lost.
    """
    print(
        "Touch each corner with the tool tip and type x y z of the tip in the base frame, in metres.\n"
        "Enter leaves a corner out; 'done' ends.",
        file=sys.stderr,
    )
    touches: list[Touch] = []
    for marker in markers:
        for corner in range(4):
            answer = _answer(marker, corner)
            if answer is None:
                return touches
            if isinstance(answer, Touch):
                touches.append(answer)
                write_touches(keep, touches)
    return touches


def _answer(marker: int, corner: int) -> Touch | str | None:
    """A touch, an empty string where the corner is left out, None where there are no more."""
    while True:
        print(f"marker {marker}, corner {corner} ({CORNERS[corner]}): ", end="", file=sys.stderr, flush=True)
        line = sys.stdin.readline()
        words = line.replace(",", " ").split()
        if not line or words == ["done"]:
            return None
        if not words:
            return ""
        try:
            x, y, z = (float(word) for word in words)
            return Touch(marker, corner, x, y, z)
        except SpecError as error:
            print(error, file=sys.stderr)
        except ValueError:
            print(f"expected three numbers such as 0.412 -0.105 0.021, got {line.strip()!r}", file=sys.stderr)
