"""``shape-obs calibrate intrinsics``: a camera's projection from a ChArUco board."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from tqdm import tqdm

from shape_obs.calibration import BoardViews, IntrinsicsFit, fit_intrinsics
from shape_obs.cli.markers import board_from
from shape_obs.cli.options import open_named, warnings_as_lines
from shape_obs.markers import DICTIONARY
from shape_obs.source import EndOfSource, RGBDSource


@dataclass(frozen=True)
class Arguments:
    """Measure a camera's projection with a printed board, and check the one that the camera tells.

    Show the board near and far, tilted by up to 45 degrees, and in every part of the image; hold it still for a moment
    in each pose. Exit code 1 if the camera's own projection is doubtful.
    """

    source: str
    """d455[:serial], FILE.db3, FILE.bag, a folder, a video file, or an environment's id."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("intrinsics.json")
    """Where the result goes."""
    views: int = 20
    """How many different views to take of a camera, or at most of a recording."""
    seconds: float = 120.0
    """How long to wait for them, of a camera."""
    board: tuple[int, int, float, float] | None = None
    """Columns, rows, side of a square and of a marker in mm; default 7 5 36 27, as `shape-obs markers --charuco`."""
    dictionary: str = DICTIONARY
    """Which family of markers the board has."""
    set: tuple[str, ...] = ()
    """KEY=VALUE ...: arguments of the source, such as exposure=0.01."""
    json: bool = False
    """Print the result as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the command; returns the exit code."""
    args = tyro.cli(Arguments, args=list(argv), prog="shape-obs calibrate intrinsics")
    if args.views < 1 or not args.seconds > 0:
        raise ValueError(f"expected --views >= 1 and --seconds > 0, got {args.views} and {args.seconds}.")
    with warnings_as_lines("shape-obs calibrate intrinsics"), open_named(args.source, settings=args.set) as source:
        fit = _measured(source, args)
    fit.save(args.out)
    print(json.dumps(fit.to_dict()) if args.json else summary(fit, args.out))
    return 0 if fit.good else 1


def summary(fit: IntrinsicsFit, out: Path) -> str:
    """The lines that the command prints."""
    it = fit.intrinsics
    lines = [
        f"{out}: {fit.views} views, corners in {100 * fit.coverage:.0f} % of the image",
        f"fitted     fx {it.fx:.2f} fy {it.fy:.2f} cx {it.cx:.2f} cy {it.cy:.2f} (+- {100 * fit.deviation:.2f} %), "
        f"corners {fit.rms:.2f} px off",
    ]
    if fit.factory is not None and fit.factory_rms is not None and fit.factory_apart is not None:
        at = fit.factory
        lines.append(
            f"factory    fx {at.fx:.2f} fy {at.fy:.2f} cx {at.cx:.2f} cy {at.cy:.2f}, "
            f"corners {fit.factory_rms:.2f} px off, rays {fit.factory_apart:.2f} px apart"
        )
    lines += [f"doubt      {doubt}" for doubt in fit.doubts]
    if fit.good and fit.factory is not None:
        lines.append("good       the factory's projection holds")
    return "\n".join(lines)


def _measured(source: RGBDSource, args: Arguments) -> IntrinsicsFit:
    views = _collected(source, args)
    missing = views.missing()
    if missing and views.taken:
        print(f"shape-obs calibrate intrinsics: few corners in the {missing} of the image", file=sys.stderr)
    board = board_from(args.board, args.dictionary)
    serial = getattr(source, "serial", None)
    return fit_intrinsics(views.taken, views.size, board, source.intrinsics, views.coverage, serial)


def _collected(source: RGBDSource, args: Arguments) -> BoardViews:
    """Views until there are enough, the source has ended, or the time is over."""
    views: BoardViews | None = None
    until = time.monotonic() + args.seconds
    with tqdm(total=args.views, unit="view", file=sys.stderr) as bar:
        while views is None or len(views.taken) < args.views:
            try:
                frame = source.read(timeout=5.0)
            except EndOfSource:
                break
            if frame.rgb is None:
                raise ValueError(f"{source.name} has no colour images: a board cannot be seen in depth.")
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
