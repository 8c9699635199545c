"""The command line, ``shape-obs COMMAND``.

Only the module of the chosen command is imported, and it imports libraries only once its arguments are read: so every
``--help`` is quick.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from io import TextIOWrapper
from pathlib import Path
from types import FrameType
from typing import Final, TextIO

from shape_obs import __version__
from shape_obs.utils.errors import Interrupted, UsageError, did_you_mean, hint_at_extra, message_of

COMMANDS: Final = {
    "demo": "run an episode of the simulated cable and draw the points",
    "tune": "choose the settings of a detector on a web page",
    "detect": "find the shape in image files",
    "record": "record frames from a camera, a file or an environment",
    "replay": "find the shape in every frame of a recording",
    "view": "show a recording in the rerun viewer",
    "extract": "find the shapes in many recordings, as a Parquet dataset",
    "fit-features": "fit principal components to recorded shapes",
    "goal": "record the current shape as a goal",
    "ablate": "train with different observations and compare the results",
    "deploy": "run a policy or a controller on a robot with a camera",
    "markers": "draw markers or a calibration board to print",
    "calibrate": "measure a camera's intrinsics, and its pose in the base frame",
    "bench": "measure the speed on this machine, and the paper's table",
}
_GROUPS: Final = ("calibrate", "bench")  # commands with subcommands


def main(argv: Sequence[str] | None = None) -> None:
    """Run a command and exit.

    The exit code is 0 on success, 1 with one line on stderr after an error, 2 after wrong usage, and 128 plus the
    signal's number after a signal, as shells expect. A file that is missing or damaged is an error, not wrong usage.
    """
    _open_streams()
    status = _run(list(sys.argv[1:] if argv is None else argv))
    sys.exit(1 if _is_output_lost() else status)


def _run(arguments: list[str]) -> int:
    """Run a command, report its error in one line, and return the exit code."""
    command, *rest = arguments or ["--help"]
    if "" not in sys.path:
        sys.path.append("")  # module:Name may lie in the current folder, as with ``python -m``
    prog = " ".join(["shape-obs", command, *rest[:1]] if command in _GROUPS else ["shape-obs", command])
    try:
        if command in ("-h", "--help", "--version"):
            print(f"shape-obs {__version__}" if command == "--version" else _usage())
            status = 0
        elif command not in COMMANDS:
            prog = "shape-obs"
            raise UsageError(f"unknown command {command!r}{did_you_mean(command, COMMANDS)}")
        else:
            with _signals():
                status = import_module(f"shape_obs.cli.{command.replace('-', '_')}").main(rest)
        sys.stdout.flush()
    except SystemExit as end:  # of the parser: --help, or wrong usage, which it has reported
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    except (ValueError, TypeError, OSError, ImportError) as error:
        lost = isinstance(error, BrokenPipeError) and (_has_no_reader(sys.stdout) or _is_output_lost())
        if not lost:
            print(f"{prog}: {message_of(error)}{hint_at_extra(error)}", file=sys.stderr)
        return 2 if isinstance(error, UsageError) else 1
    except Interrupted as interrupted:
        print(f"{prog}: {message_of(interrupted)}", file=sys.stderr)
        return 128 + interrupted.signum
    return status


def _open_streams() -> None:
    """Open the output streams that are missing, as in ``pythonw``; what a stream cannot encode it prints as codes."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115 - until the process ends
        elif isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _is_output_lost() -> bool:
    """Return whether output cannot be written, as when its reader has ended, and write the rest of it nowhere.

    Without this the interpreter fails again when it flushes the streams.
    """
    lost = False
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:  # noqa: PERF203
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
            lost = True
    return lost


def _has_no_reader(stream: TextIO) -> bool:
    """Return whether a stream is a pipe whose reader has ended; without a buffer, flushing does not show that."""
    try:
        poll = select.poll()
        poll.register(stream.fileno(), 0)
    except (OSError, AttributeError):  # no file, or Windows, which has no poll
        return False
    return any(event & select.POLLERR for _, event in poll.poll(0))


@contextmanager
def _signals() -> Iterator[None]:
    """Raise ``Interrupted`` on Ctrl-C and SIGTERM, also if a library turns it into another error."""
    received: list[int] = []

    def handle(signum: int, frame: FrameType | None) -> None:
        received.append(signum)
        raise Interrupted(signum)

    main_thread = threading.current_thread() is threading.main_thread()
    numbers = (signal.SIGINT, signal.SIGTERM) if main_thread else ()  # elsewhere Python cannot set handlers
    before = {number: signal.getsignal(number) for number in numbers}
    try:
        for number, handler in before.items():
            if handler is not signal.SIG_IGN:  # as for a job in the background
                signal.signal(number, handle)
        yield
    except (Exception, KeyboardInterrupt) as error:
        if isinstance(error, Interrupted) or not received:
            raise
        raise Interrupted(received[0]) from error
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


def run_part(command: str, noun: str, parts: Mapping[str, str], argv: Sequence[str]) -> int:
    """Run the subcommand that ``argv`` starts with, or list all of them; return the exit code.

    Args:
        command: The command, such as ``"bench"``; its subcommands are modules of ``shape_obs.cli.bench``.
        noun: What error messages call a subcommand.
        parts: Each subcommand and what it does.
        argv: The subcommand and its arguments.

    Raises:
        UsageError: There is no such subcommand.
    """
    if not argv or argv[0] in ("-h", "--help"):
        width = max(map(len, parts))
        print(f"usage: shape-obs {command} {{{','.join(parts)}}} [OPTIONS]\n")
        print("\n".join(f"  {name:<{width}} {what}" for name, what in parts.items()))
        return 0
    name, *rest = argv
    if name not in parts:
        raise UsageError(f"unknown {noun} {name!r}{did_you_mean(name, parts)}")
    return int(import_module(f"shape_obs.cli.{command}.{name}").main(rest))


def _usage() -> str:
    lines = [f"  {name:<12} {what}" for name, what in COMMANDS.items()]
    return "\n".join(
        ["usage: shape-obs COMMAND [OPTIONS]", "", *lines, "", "`shape-obs COMMAND --help` lists a command's options."]
    )
