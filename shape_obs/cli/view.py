"""``shape-obs view``: show a recording in rerun."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from shape_obs.cli.options import check_source, open_named, read_settings, warnings_as_lines
from shape_obs.cli.outputs import Overwrite, check_outputs
from shape_obs.cli.parsing import Option, parse
from shape_obs.cli.rerun_option import AUTO, FrameLog, check_target, open_rerun, rerun_file, working_file
from shape_obs.utils.errors import UsageError

if TYPE_CHECKING:
    from shape_obs.source import RGBDSource


@dataclass(frozen=True)
class Arguments:
    """Show a recording in rerun: images, depth as a cloud, and with --config the shapes.

    Without --out it opens the rerun viewer, or, if there is no display, writes RECORDING.rrd into the working folder.
    After Ctrl-C the file contains the frames up to that point. It needs the extra 'rerun'.
    """

    recording: Annotated[str, Option("RECORDING", positional=True, check=check_source)]
    """A folder, FILE.db3, FILE.bag or a video file; or, with --frames, d455[:serial] or the id of an environment."""
    config: Annotated[Path | None, Option("FILE", "detection", existing="config file")] = None
    """A YAML config file; also shows the shapes."""
    out: Annotated[str | None, Option("FILE.rrd", "output", "-o", check=check_target)] = None
    """Write this file, or show the recording in the running viewer with this address."""
    overwrite: Overwrite = False
    """Replace existing files."""
    frames: Annotated[int | None, Option("N", "source", least=1)] = None
    """Largest number of frames."""
    extrinsics: Annotated[Path | None, Option("FILE", "source", existing="file of extrinsics")] = None
    """A file with the pose of the camera in the base frame; replaces the recorded pose."""
    set: Annotated[tuple[str, ...], Option("KEY=VALUE ...", "source", check=read_settings)] = ()
    """Arguments of the source."""


def main(argv: Sequence[str]) -> int:
    """Run the command and return the exit code."""
    args = parse(Arguments, argv, "shape-obs view")
    check_outputs(args, rerun_file(args.out or AUTO, working_file(args.recording)))
    from shape_obs.config.config_file import load_config

    arguments = None if args.config is None else load_config(args.config)
    with warnings_as_lines("shape-obs view"), open_named(args.recording, args.extrinsics, args.set) as source:
        if source.kind in ("d455", "software", "env") and args.frames is None:
            raise UsageError(f"{source.name} never ends: give --frames N.")
        count, path = _show(args, source, arguments)
    print(f"frames          {count}" + (f"\nwrote           {path}" if path else ""))
    return 0


def _show(args: Arguments, source: RGBDSource, arguments: dict[str, Any] | None) -> tuple[int, Path | None]:
    """Log all frames; return their number, and the file if there is one."""
    from tqdm import tqdm

    from shape_obs.cli.replay import make_detector
    from shape_obs.recording import replay
    from shape_obs.recording.format import read_moments

    detector = None if arguments is None else make_detector(arguments, source)
    length = args.frames or (len(source) if hasattr(source, "__len__") else None)  # pyright: ignore[reportArgumentType]
    count = 0
    with open_rerun(args.out or AUTO, working_file(args.recording), "shape-obs view") as stream:
        log = FrameLog(stream, detector, arguments)
        frames: Iterable[Any] = (
            ((moment, None) for moment in read_moments(source, args.frames))
            if detector is None
            else replay(source, detector, args.frames)
        )
        for moment, detection in tqdm(frames, total=length, unit="frame", leave=False, desc="reading"):
            log.add(moment, detection)
            count += 1
    return count, stream.path
