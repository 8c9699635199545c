"""``shape-obs record``: frames of any source, into a folder."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from tqdm import tqdm

from shape_obs.cli.options import open_named, warnings_as_lines
from shape_obs.recording import Recorded, record
from shape_obs.recording.format import read_moments
from shape_obs.recording.recorder import Depth
from shape_obs.source import RGBDSource, SourceError


@dataclass(frozen=True)
class Arguments:
    """Record what a camera, a file or an environment shows.

    Ctrl-C ends a recording cleanly, and whatever else ends it, the frames that were written are kept. Exit code 1 if
    the source broke off.
    """

    source: str
    """d455[:serial], FILE.db3, FILE.bag, a folder, a video file, or an environment's id."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """A new or empty folder; or FILE.db3 for librealsense's own format, of a camera alone."""
    frames: int | None = None
    """How many; default until the source ends, or Ctrl-C."""
    seconds: float | None = None
    """How long, by the frames' stamps."""
    extrinsics: Path | None = None
    """A file that says where the camera stands in the base frame; it is kept in the recording."""
    depth: Depth = "auto"
    """'auto' records it where there is any, 'yes' insists on it, 'no' leaves it out."""
    set: tuple[str, ...] = ()
    """KEY=VALUE ...: arguments of the source, such as exposure=0.01, or seed=1 actions=random of an environment."""
    json: bool = False
    """Print the summary as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the command; returns the exit code."""
    args = tyro.cli(Arguments, args=list(argv), prog="shape-obs record")
    with warnings_as_lines("shape-obs record"):
        recorded = _raw(args) if args.out.suffix in (".db3", ".bag") else _folder(args)
    print(json.dumps(recorded.to_dict()) if args.json else summary(recorded))
    if recorded.stopped not in ("done", "interrupted"):
        print(f"shape-obs record: {recorded.stopped}", file=sys.stderr)
        return 1
    return 0


def summary(recorded: Recorded) -> str:
    """The lines that the command prints."""
    lines = [f"{recorded.path}: {recorded.frames} frames, {recorded.seconds:.2f} s"]
    if recorded.missed:
        lines.append(
            f"missed          {recorded.missed} frames never came, by the camera's count (USB, or a busy machine)"
        )
    if recorded.dropped:
        lines.append(f"dropped         {recorded.dropped} frames: this machine did not encode and write them in time")
    if recorded.stopped == "interrupted":
        lines.append("interrupted     what was written is whole")
    return "\n".join(lines)


def _folder(args: Arguments) -> Recorded:
    source = open_named(args.source, args.extrinsics, args.set)
    limits: dict[str, Any] = {"frames": args.frames, "seconds": args.seconds, "depth": args.depth}
    try:
        with _bar(args) as bar:
            return record(source, args.out, **limits, on_frame=bar.update)
    finally:
        source.disconnect()


def _raw(args: Arguments) -> Recorded:
    """What the camera sent, before rectification: librealsense writes it while frames are read."""
    if args.depth == "no":
        raise ValueError(
            f"{args.out}: librealsense's own format holds what the camera sends; --depth no needs a folder."
        )
    source = _camera(args)
    told = Recorded(args.out)
    with source, _bar(args) as bar:
        try:
            for moment in read_moments(source, args.frames, args.seconds):
                told.saw(moment.frame)
                told.frames += 1
                bar.update()
        except KeyboardInterrupt:
            told.stopped = "interrupted"
        except SourceError as error:
            if not told.frames:
                raise
            told.stopped = str(error)
    return told


def _camera(args: Arguments) -> RGBDSource:
    if not args.source.lower().startswith("d455"):
        raise ValueError(
            f"{args.out}: only a camera (d455) can be recorded to {args.out.suffix}; give a folder for {args.source}."
        )
    return open_named(args.source, args.extrinsics, args.set, record_to=args.out)


def _bar(args: Arguments) -> tqdm:
    return tqdm(total=args.frames, unit="frame", leave=False, desc="recording")
