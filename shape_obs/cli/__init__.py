"""The command line: ``shape-obs COMMAND``. Only the command that runs is imported."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Final

from shape_obs import __version__
from shape_obs.spec import did_you_mean

COMMANDS: Final = {
    "demo": "run an episode of the simulated cable and draw what is seen",
    "detect": "find the shape in image files",
    "record": "record what a camera, a file or an environment shows",
    "replay": "find the shape in every frame of a recording, and export it",
    "extract": "find the shapes in many recordings, as a Parquet dataset",
    "fit-features": "fit principal components to recorded shapes",
    "goal": "record the shape that is seen now as a goal",
    "ablate": "train with other things to see, and compare what is reached",
    "deploy": "run a controller on a robot, from the camera alone",
    "markers": "draw markers or a calibration board to print",
    "calibrate": "measure a camera's projection, and its place in the robot's base frame",
    "bench": "measure accuracy, time and quality",
}


def main(argv: Sequence[str] | None = None) -> None:
    """Run a command. Exits with 0; with 1 and one line on stderr if something is wrong; with 2 on wrong usage.

    After a signal it exits with 128 plus the signal's number, as shells expect.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments or arguments[0] in ("-h", "--help"):
        print(_usage())
        sys.exit(0)
    if arguments[0] == "--version":
        print(f"shape-obs {__version__}")
        sys.exit(0)
    command, *rest = arguments
    if command not in COMMANDS:
        print(f"shape-obs: unknown command {command!r}{did_you_mean(command, COMMANDS)}", file=sys.stderr)
        sys.exit(2)
    try:
        status = import_module(f"shape_obs.cli.{command.replace('-', '_')}").main(rest)
        sys.stdout.flush()
    except BrokenPipeError:
        # Nobody reads the output any more; without this the interpreter fails again when it flushes it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except (ValueError, TypeError, OSError, ImportError) as error:
        message = " ".join(str(error).split()) or type(error).__name__
        print(f"shape-obs {command}: {message}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt as interrupt:
        print(f"shape-obs {command}: {str(interrupt) or 'interrupted'}", file=sys.stderr)
        sys.exit(128 + getattr(interrupt, "signum", signal.SIGINT))
    sys.exit(status)


def _usage() -> str:
    lines = [f"  {name:<12} {what}" for name, what in COMMANDS.items()]
    return "\n".join(
        ["usage: shape-obs COMMAND [OPTIONS]", "", *lines, "", "`shape-obs COMMAND --help` tells a command's options."]
    )
