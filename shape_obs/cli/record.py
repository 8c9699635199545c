"""``shape-obs record``: record frames of any source into a folder."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from shape_obs.cli.options import check_source, open_named, read_settings, warnings_as_lines
from shape_obs.cli.outputs import Overwrite, check_outputs
from shape_obs.cli.parsing import Option, parse
from shape_obs.cli.rerun_option import TARGET, FrameLog, check_target, open_rerun, rerun_file, with_rerun_value
from shape_obs.utils.errors import UsageError, ending

if TYPE_CHECKING:
    from shape_obs.recording import Moment, Recorded
    from shape_obs.source import RGBDSource


#: Words for RealSense cameras, as ``open_source`` has them; it is not imported before the arguments are checked.
_REALSENSE: Final = re.compile(r"d4\d\d(?::|$)", re.IGNORECASE)


@dataclass(frozen=True)
class Arguments:
    """Record frames from a camera, a file or an environment.

    Recordings of an environment also contain actions, rewards, ends of episodes and the robot's state.

    Ctrl-C or SIGTERM ends a recording cleanly. After an error the frames that were written are kept. The exit code is 1
    if the source failed.
    """

    source: Annotated[str, Option("SOURCE", "source", check=check_source)]
    """A camera (d455[:serial], d435, webcam:0, module:Class), a recording (FILE.db3, FILE.bag, FILE.mcap, a folder, a
    video file) or the id of an environment."""
    out: Annotated[Path, Option("RECORDING", "output", "-o")]
    """A new or empty folder, or FILE.db3 for librealsense's own format (RealSense cameras only)."""
    frames: Annotated[int | None, Option("N", "length", least=1)] = None
    """Number of frames; default: until the source ends or Ctrl-C."""
    seconds: Annotated[float | None, Option("SECONDS", "length", above=0)] = None
    """Length of the recording, by the stamps of the frames."""
    extrinsics: Annotated[Path | None, Option("FILE", "source", existing="file of extrinsics")] = None
    """A file with the pose of the camera in the base frame; it is stored in the recording."""
    depth: Annotated[Literal["auto", "yes", "no"], Option(group="source")] = "auto"
    """'auto' records depth if the source has it, 'yes' requires it, 'no' leaves it out."""
    set: Annotated[tuple[str, ...], Option("KEY=VALUE ...", "source", check=read_settings)] = ()
    """Arguments of the source, such as exposure=0.01, or seed=1 actions=random for an environment."""
    rerun: Annotated[str | None, Option(TARGET, "output", check=check_target)] = None
    """Also log the frames to rerun: to FILE.rrd, or to a running viewer by its address. Without a value, open the
    viewer, or write OUT.rrd if there is no display (needs the extra 'rerun')."""
    overwrite: Overwrite = False
    """Replace an existing FILE.rrd; recordings are never replaced."""
    json: Annotated[bool, Option(group="output")] = False
    """Print the summary as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the command and return the exit code."""
    args = parse(Arguments, with_rerun_value(argv), "shape-obs record")
    raw = args.out.suffix in (".db3", ".bag")
    if raw:
        _check_raw(args)
    check_outputs(args, rerun_file(args.rerun, args.out))
    with warnings_as_lines("shape-obs record"):
        recorded = _raw(args) if raw else _folder(args)
    print(json.dumps(recorded.to_dict()) if args.json else summary(recorded))
    if recorded.stopped not in ("done", "interrupted"):
        print(f"shape-obs record: {recorded.stopped}", file=sys.stderr)
        return 1
    return 0


def summary(recorded: Recorded) -> str:
    """Return the lines that the command prints."""
    lines = [f"{recorded.path}: {recorded.frames} frames, {recorded.seconds:.2f} s"]
    if recorded.actions:
        lines.append(f"actions         {recorded.actions}, with rewards and ends of episodes")
    if recorded.missed:
        lines.append(
            f"missed          {recorded.missed} frames are missing from the camera's count (USB, or a busy machine)"
        )
    if recorded.dropped:
        lines.append(f"dropped         {recorded.dropped} frames, which this machine could not write in time")
    if recorded.stopped == "interrupted":
        lines.append("interrupted     the recording is complete up to here")
    return "\n".join(lines)


def _folder(args: Arguments) -> Recorded:
    """Record to a folder."""
    from shape_obs.recording import record

    source = open_named(args.source, args.extrinsics, args.set)
    limits: dict[str, Any] = {"frames": args.frames, "seconds": args.seconds, "depth": args.depth}
    with ending(source.disconnect), _shown(args, source) as show:
        return record(source, args.out, **limits, on_frame=show)


def _raw(args: Arguments) -> Recorded:
    """Record the camera's own streams, before rectification; librealsense writes them while frames are read."""
    from shape_obs.recording import Recorded
    from shape_obs.recording.format import read_moments
    from shape_obs.source import SourceError

    source = open_named(args.source, args.extrinsics, args.set, record_to=args.out)
    recorded = Recorded(args.out)
    with source, _shown(args, source) as show:
        try:
            for moment in read_moments(source, args.frames, args.seconds):
                recorded.count(moment.frame)
                recorded.frames += 1
                show(moment)
        except KeyboardInterrupt:
            recorded.stopped = "interrupted"
        except SourceError as error:
            if not recorded.frames:
                raise
            recorded.stopped = str(error)
    return recorded


def _check_raw(args: Arguments) -> None:
    """Reject what cannot be recorded in librealsense's own format."""
    if args.depth == "no":
        raise UsageError(f"{args.out}: librealsense's own format always contains depth; use a folder with --depth no.")
    if not _REALSENSE.match(args.source):
        raise UsageError(
            f"{args.out}: only a RealSense camera can be recorded to {args.out.suffix}; give a folder for "
            f"{args.source}."
        )


@contextmanager
def _shown(args: Arguments, source: RGBDSource) -> Iterator[Callable[[Moment], None]]:
    """Yield a function that shows a frame: in the progress bar, and with ``--rerun`` in rerun.

    Frames of a live source are logged in a thread, the newest one first, so that none is missed.
    """
    from tqdm import tqdm

    from shape_obs.utils.threads import Newest

    with ExitStack() as stack:
        bar = stack.enter_context(tqdm(total=args.frames, unit="frame", leave=False, desc="recording"))
        log: Callable[[Moment], object] | None = None
        if args.rerun is not None:
            stream = stack.enter_context(open_rerun(args.rerun, args.out, "shape-obs record"))
            log = FrameLog(stream).add
            if source.live:
                thread: Newest[Moment] = Newest(log, "rerun")
                stack.callback(thread.close)
                log = thread.put

        def show(moment: Moment) -> None:
            bar.update()
            if log is not None:
                log(moment)

        yield show
