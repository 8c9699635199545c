"""``shape-obs calibrate intrinsics``: measure the intrinsics of a camera with a ChArUco board."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from shape_obs.cli.markers import board_from
from shape_obs.cli.options import DICTIONARY, check_source, open_named, read_settings, warnings_as_lines
from shape_obs.cli.outputs import Overwrite, check_outputs
from shape_obs.cli.parsing import Option, parse

if TYPE_CHECKING:
    from shape_obs.calibration import BoardViews, IntrinsicsFit
    from shape_obs.source import RGBDSource


@dataclass(frozen=True)
class Arguments:
    """Measure the intrinsics of a camera with a printed board, and check those that the camera reports.

    Show the board near and far, tilted by up to 45 degrees, and in every part of the image; hold it still for a moment
    in each pose. The exit code is 1 if the camera's own intrinsics are doubtful.
    """

    source: Annotated[str, Option("SOURCE", "source", check=check_source)]
    """A camera (d455[:serial], d435, webcam:0, module:Class), a recording (FILE.db3, FILE.bag, FILE.mcap, a folder, a
    video file) or the id of an environment."""
    out: Annotated[Path, Option("FILE", "output", "-o")] = Path("intrinsics.json")
    """File for the result."""
    overwrite: Overwrite = False
    """Replace existing files."""
    views: Annotated[int, Option("N", "source", least=1)] = 20
    """Number of different views to take from a camera; the largest number for a recording."""
    seconds: Annotated[float, Option("SECONDS", "source", above=0)] = 120.0
    """Time limit in seconds for the views of a camera."""
    board: Annotated[tuple[int, int, float, float] | None, Option("COLUMNS ROWS SQUARE MARKER", "marker", above=0)] = (
        None
    )
    """Columns, rows, side of a square and of a marker in mm; default: 7 5 36 27, as `shape-obs markers --charuco`."""
    dictionary: Annotated[str, Option("NAME", "marker")] = DICTIONARY
    """Marker dictionary of the board."""
    set: Annotated[tuple[str, ...], Option("KEY=VALUE ...", "source", check=read_settings)] = ()
    """Arguments of the source, such as exposure=0.01."""
    json: Annotated[bool, Option(group="output")] = False
    """Print the result as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the command and return the exit code."""
    args = parse(Arguments, argv, "shape-obs calibrate intrinsics")
    check_outputs(args, args.out)
    with warnings_as_lines("shape-obs calibrate intrinsics"), open_named(args.source, settings=args.set) as source:
        fit = _measured(source, args)
    fit.save(args.out)
    print(json.dumps(fit.to_dict()) if args.json else summary(fit, args.out))
    return 0 if fit.good else 1


def summary(fit: IntrinsicsFit, out: Path) -> str:
    """Return the lines that the command prints."""
    it = fit.intrinsics
    lines = [
        f"{out}: {fit.views} views, corners in {100 * fit.coverage:.0f} % of the image",
        f"fitted     fx {it.fx:.2f} fy {it.fy:.2f} cx {it.cx:.2f} cy {it.cy:.2f} (+- {100 * fit.deviation:.2f} %), "
        f"corner residual {fit.rms:.2f} px",
    ]
    if fit.factory is not None and fit.factory_rms is not None and fit.factory_apart is not None:
        at = fit.factory
        lines.append(
            f"factory    fx {at.fx:.2f} fy {at.fy:.2f} cx {at.cx:.2f} cy {at.cy:.2f}, "
            f"corner residual {fit.factory_rms:.2f} px, rays differ by {fit.factory_apart:.2f} px"
        )
    lines += [f"doubt      {doubt}" for doubt in fit.doubts]
    if fit.good and fit.factory is not None:
        lines.append("good       the factory's intrinsics are confirmed")
    return "\n".join(lines)


def _measured(source: RGBDSource, args: Arguments) -> IntrinsicsFit:
    """Collect views of the board and fit the intrinsics to them."""
    from shape_obs.calibration import fit_intrinsics

    views = _collect_views(source, args)
    missing = views.missing()
    if missing and views.taken:
        print(f"shape-obs calibrate intrinsics: few corners in the {missing} of the image", file=sys.stderr)
    board = board_from(args.board, args.dictionary)
    serial = getattr(source, "serial", None)
    return fit_intrinsics(views.taken, views.size, board, source.intrinsics, views.coverage, serial)


def _collect_views(source: RGBDSource, args: Arguments) -> BoardViews:
    """Collect views until there are enough, the source ends, or the time limit is reached."""
    from tqdm import tqdm

    from shape_obs.calibration import BoardViews
    from shape_obs.source import EndOfSource

    views: BoardViews | None = None
    until = time.monotonic() + args.seconds
    with tqdm(total=args.views, unit="view", file=sys.stderr) as bar:
        while views is None or len(views.taken) < args.views:
            try:
                frame = source.read(timeout=5.0)
            except EndOfSource:
                break
            if frame.rgb is None:
                raise ValueError(f"{source.name} has no colour images, which the board needs.")
            if views is None:
                size = (frame.rgb.shape[0], frame.rgb.shape[1])
                views = BoardViews(board_from(args.board, args.dictionary), size, still=source.live)
            why = views.offer(frame.rgb)
            bar.update(0 if why else 1)
            bar.set_postfix_str(why or "taken")
            if source.live and time.monotonic() > until:
                break
    if views is None:
        raise ValueError(f"{source.name} has no images.")
    return views
