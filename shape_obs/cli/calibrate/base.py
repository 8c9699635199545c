"""``shape-obs calibrate base``: a camera's place in the robot's base frame.

Touches, asked for one by one.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from shape_obs.calibration import BaseFit, Touch, fit_base, read_touches, write_touches
from shape_obs.calibration.touch_points import CORNERS, Place, Sighting, sight
from shape_obs.cli.options import open_named, warnings_as_lines
from shape_obs.markers import DICTIONARY
from shape_obs.spec import SpecError


@dataclass(frozen=True)
class Arguments:
    """Measure where the camera stands: the robot touches corners of markers, and the camera looks at them.

    Touch four corners or more, all around the table. Without --touches the command asks for each corner in turn, and
    keeps the answers in a file. Exit code 1, and nothing written, if the touches lie off by more than --max-rms, or one
    of them does not fit to the others.
    """

    source: str
    """d455[:serial], FILE.db3, FILE.bag, a folder, a video file, or an environment's id."""
    touches: Path | None = None
    """A CSV file with the header marker,corner,x,y,z, or a JSON list of such objects: metres, base frame."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("extrinsics.json")
    """Where the place goes."""
    size: float | None = None
    """Side of a marker's black square, mm; needed where there is no depth."""
    dictionary: str = DICTIONARY
    """Which family of markers."""
    frames: int = 30
    """Frames to look at; their median counts."""
    max_rms: float = 3.0
    """Millimetres by which the touches may lie off, rms."""
    leave_out: bool = False
    """Leave out touches that do not fit to the others, instead of writing nothing."""
    max_age_days: float = 30.0
    """After so many days the place is not trusted any more."""
    set: tuple[str, ...] = ()
    """KEY=VALUE ...: arguments of the source, such as exposure=0.01."""
    json: bool = False
    """Print the result as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the command; returns the exit code."""
    args = tyro.cli(Arguments, args=list(argv), prog="shape-obs calibrate base")
    if args.frames < 1 or not args.max_rms > 0 or not args.max_age_days > 0:
        raise ValueError("expected --frames >= 1, --max-rms > 0 and --max-age-days > 0.")
    given = None if args.touches is None else read_touches(args.touches)
    with warnings_as_lines("shape-obs calibrate base"), open_named(args.source, settings=args.set) as source:
        seen = sight(source, args.frames, args.dictionary, None if args.size is None else args.size / 1000)
        serial = getattr(source, "serial", None)
    if given is None:
        print(f"seen: markers {', '.join(map(str, seen.markers))}", file=sys.stderr)
        given = ask_touches(seen.markers, args.out.with_name(f"{args.out.stem}_touches.csv"))
    touches = _seen_ones(given, seen.places)
    fit = _fitted(touches, seen, serial, args)
    while args.leave_out and fit.suspect is not None:
        left_out = touches.pop(fit.suspect)
        print(f"left out: {left_out.name}, {1000 * fit.suspect_off:.1f} mm off", file=sys.stderr)
        fit = _fitted(touches, seen, serial, args)
    trouble = _trouble(fit, touches, args.max_rms)
    if not trouble:
        fit.extrinsics.save(args.out)
    print(json.dumps(_plain(fit, touches, seen)) if args.json else summary(fit, touches, seen))
    print(
        f"shape-obs calibrate base: nothing was written: {trouble}" if trouble else f"wrote {args.out}", file=sys.stderr
    )
    return 1 if trouble else 0


def summary(fit: BaseFit, touches: Sequence[Touch], seen: Sighting) -> str:
    """The lines that the command prints."""
    how = "their depth" if seen.by_depth else "the markers' size"
    lines = [f"{len(touches)} touches, {1000 * fit.rms:.2f} mm off (rms); corners seen by {how}"]
    for i, (touch, off) in enumerate(zip(touches, fit.residuals, strict=True)):
        lines.append(f"{1000 * off:7.2f} mm  {touch.name}{'  <- suspect' if i == fit.suspect else ''}")
    return "\n".join(lines)


def _fitted(touches: Sequence[Touch], seen: Sighting, serial: str | None, args: Arguments) -> BaseFit:
    return fit_base(
        [seen.places[touch.marker, touch.corner] for touch in touches],
        [(touch.x, touch.y, touch.z) for touch in touches],
        seen.intrinsics,
        serial,
        args.max_age_days,
    )


def _trouble(fit: BaseFit, touches: Sequence[Touch], max_rms: float) -> str:
    """Why a place is not to be trusted; empty if it is."""
    if fit.suspect is not None:
        return (
            f"{touches[fit.suspect].name} lies {1000 * fit.suspect_off:.1f} mm off where the others put it; touch it "
            "again, or give --leave-out."
        )
    if 1000 * fit.rms > max_rms:
        return f"the touches lie {1000 * fit.rms:.1f} mm off, more than --max-rms {max_rms:g}."
    return ""


def _seen_ones(given: Sequence[Touch], places: Mapping[Place, Any]) -> list[Touch]:
    """The touches of markers that the camera sees; what is left out is told."""
    unseen = sorted({touch.marker for touch in given if (touch.marker, touch.corner) not in places})
    if unseen:
        told = ", ".join(map(str, unseen))
        print(f"shape-obs calibrate base: left out, not seen by the camera: markers {told}", file=sys.stderr)
    return [touch for touch in given if (touch.marker, touch.corner) in places]


def _plain(fit: BaseFit, touches: Sequence[Touch], seen: Sighting) -> dict[str, Any]:
    return {
        "extrinsics": fit.extrinsics.to_dict(),
        "rms_mm": 1000 * fit.rms,
        "by_depth": seen.by_depth,
        "touches": [
            {**touch.to_dict(), "off_mm": 1000 * float(off), "suspect": i == fit.suspect}
            for i, (touch, off) in enumerate(zip(touches, np.asarray(fit.residuals), strict=True))
        ],
    }


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
