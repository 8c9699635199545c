"""``shape-obs calibrate base``: measure the pose of a camera in the robot's base frame."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from shape_obs.cli.options import DICTIONARY, check_source, open_named, read_settings, warnings_as_lines
from shape_obs.cli.outputs import Overwrite, check_outputs
from shape_obs.cli.parsing import Option, parse

if TYPE_CHECKING:
    from shape_obs.calibration import BaseFit, Touch
    from shape_obs.calibration.touch_points import MarkerCorner, Sighting


@dataclass(frozen=True)
class Arguments:
    """Measure the pose of the camera from marker corners that the robot touches and the camera sees.

    Touch at least four corners all around the table. Without --touches the command asks for each corner in turn, and
    saves the answers in a file. The exit code is 1, and nothing is written, if the residual of the touches exceeds
    --max-rms, or if one of them does not agree with the others.
    """

    source: Annotated[str, Option("SOURCE", "source", check=check_source)]
    """A camera (d455[:serial], d435, webcam:0, module:Class), a recording (FILE.db3, FILE.bag, FILE.mcap, a folder, a
    video file) or the id of an environment."""
    touches: Annotated[Path | None, Option("FILE", "touch", existing="file of touches")] = None
    """A CSV file with the header marker,corner,x,y,z, or a JSON list of such objects; metres, base frame."""
    out: Annotated[Path, Option("FILE", "output", "-o")] = Path("extrinsics.json")
    """File for the pose."""
    size: Annotated[float | None, Option("MM", "marker", above=0)] = None
    """Side of a marker's black square in mm; needed without depth."""
    dictionary: Annotated[str, Option("NAME", "marker")] = DICTIONARY
    """Marker dictionary."""
    frames: Annotated[int, Option("N", "source", least=1)] = 30
    """Number of frames; the corners are their median."""
    max_rms: Annotated[float, Option("MM", "touch", above=0)] = 3.0
    """Largest accepted rms residual of the touches in mm."""
    leave_out: Annotated[bool, Option(group="touch")] = False
    """Leave out touches that do not agree with the others, instead of writing nothing."""
    max_age_days: Annotated[float, Option("DAYS", "output", above=0)] = 30.0
    """Number of days after which sources warn that the pose is old."""
    set: Annotated[tuple[str, ...], Option("KEY=VALUE ...", "source", check=read_settings)] = ()
    """Arguments of the source, such as exposure=0.01."""
    overwrite: Overwrite = False
    """Replace existing files."""
    json: Annotated[bool, Option(group="output")] = False
    """Print the result as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the command and return the exit code."""
    args = parse(Arguments, argv, "shape-obs calibrate base")
    answers = args.out.with_name(f"{args.out.stem}_touches.csv") if args.touches is None else None
    hint = "" if answers is None else f"; --touches {answers} reads earlier answers"
    check_outputs(args, args.out, answers, hint=hint)
    from shape_obs.calibration import read_touches
    from shape_obs.calibration.touch_points import sight

    given = [] if args.touches is None else read_touches(args.touches)
    with warnings_as_lines("shape-obs calibrate base"), open_named(args.source, settings=args.set) as source:
        seen = sight(source, args.frames, args.dictionary, None if args.size is None else args.size / 1000)
        serial = getattr(source, "serial", None)
    if answers is not None:
        print(f"visible: markers {', '.join(map(str, seen.markers))}", file=sys.stderr)
        given = ask_touches(seen.markers, answers)
    touches = _visible(given, seen.corners)
    fit = _fitted(touches, seen, serial, args)
    while args.leave_out and fit.suspect is not None:
        left_out = touches.pop(fit.suspect)
        print(f"left out: {left_out.name}, {1000 * fit.suspect_off:.1f} mm off", file=sys.stderr)
        fit = _fitted(touches, seen, serial, args)
    problem = _problem(fit, touches, args.max_rms)
    if not problem:
        fit.extrinsics.save(args.out)
    print(json.dumps(_to_json(fit, touches, seen)) if args.json else summary(fit, touches, seen))
    print(
        f"shape-obs calibrate base: nothing was written: {problem}" if problem else f"wrote {args.out}", file=sys.stderr
    )
    return 1 if problem else 0


def summary(fit: BaseFit, touches: Sequence[Touch], seen: Sighting) -> str:
    """Return the lines that the command prints."""
    how = "depth" if seen.by_depth else "the size of the markers"
    lines = [f"{len(touches)} touches, rms residual {1000 * fit.rms:.2f} mm; corners located by {how}"]
    for i, (touch, off) in enumerate(zip(touches, fit.residuals, strict=True)):
        lines.append(f"{1000 * off:7.2f} mm  {touch.name}{'  <- suspect' if i == fit.suspect else ''}")
    return "\n".join(lines)


def _fitted(touches: Sequence[Touch], seen: Sighting, serial: str | None, args: Arguments) -> BaseFit:
    from shape_obs.calibration import fit_base

    return fit_base(
        [seen.corners[touch.marker, touch.corner] for touch in touches],
        [(touch.x, touch.y, touch.z) for touch in touches],
        seen.intrinsics,
        serial,
        args.max_age_days,
    )


def _problem(fit: BaseFit, touches: Sequence[Touch], max_rms: float) -> str:
    """Return why a pose is rejected; empty if it is accepted."""
    if fit.suspect is not None:
        return (
            f"{touches[fit.suspect].name} lies {1000 * fit.suspect_off:.1f} mm from where the others put it; touch it "
            "again, or give --leave-out."
        )
    if 1000 * fit.rms > max_rms:
        return f"the rms residual of the touches is {1000 * fit.rms:.1f} mm, more than --max-rms {max_rms:g}."
    return ""


def _visible(given: Sequence[Touch], corners: Mapping[MarkerCorner, Any]) -> list[Touch]:
    """Return the touches of markers that the camera sees, and print which markers are left out."""
    unseen = sorted({touch.marker for touch in given if (touch.marker, touch.corner) not in corners})
    if unseen:
        markers = ", ".join(map(str, unseen))
        print(f"shape-obs calibrate base: left out, not seen by the camera: markers {markers}", file=sys.stderr)
    return [touch for touch in given if (touch.marker, touch.corner) in corners]


def _to_json(fit: BaseFit, touches: Sequence[Touch], seen: Sighting) -> dict[str, Any]:
    return {
        "extrinsics": fit.extrinsics.to_dict(),
        "rms_mm": 1000 * fit.rms,
        "by_depth": seen.by_depth,
        "touches": [
            {**touch.to_dict(), "off_mm": 1000 * float(off), "suspect": i == fit.suspect}
            for i, (touch, off) in enumerate(zip(touches, fit.residuals, strict=True))
        ],
    }


def ask_touches(markers: Sequence[int], backup: Path) -> list[Touch]:
    """Ask for the position of the tool tip at each corner of each marker.

    Args:
        markers: The ids of the markers.
        backup: A CSV file that is rewritten after each answer, so that no answer is lost.
    """
    from shape_obs.calibration import Touch, write_touches

    print(
        "Touch each corner with the tool tip and type x y z of the tip in the base frame, in metres.\n"
        "Enter skips a corner; 'done' ends.",
        file=sys.stderr,
    )
    touches: list[Touch] = []
    for marker in markers:
        for corner in range(4):
            answer = _ask_corner(marker, corner)
            if answer is None:
                return touches
            if isinstance(answer, Touch):
                touches.append(answer)
                write_touches(backup, touches)
    return touches


def _ask_corner(marker: int, corner: int) -> Touch | str | None:
    """Return a touch, an empty string if the corner is skipped, or None if there are no more touches."""
    from shape_obs.calibration import Touch
    from shape_obs.calibration.touch_points import CORNERS
    from shape_obs.spec import SpecError

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
