"""``shape-obs tune``: choose the settings of a detector on a web page, from what a camera or a file shows."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from shape_obs.cli.options import open_named, warnings_as_lines

if TYPE_CHECKING:
    from shape_obs.source import RGBDSource


@dataclass(frozen=True)
class Arguments:
    """Choose the settings of a detector on a web page, and save them as the YAML file that every command reads.

    Prints the URL of the page and serves it until Ctrl-C. Only this machine can open it, unless --host is given.
    """

    source: Annotated[str, tyro.conf.Positional]
    """A photo, a video, a folder of photos, a recording, d455[:serial], FILE.db3, FILE.bag, or the id of an
    environment."""
    config: Path | None = None
    """A YAML config file to start with."""
    save: Path | None = None
    """The YAML file that Save writes; default: --config, or shape.yaml."""
    port: int = 8600
    """Port of the page; 0 for any that is free."""
    host: str = "127.0.0.1"
    """Address of the network interface that serves the page; 0.0.0.0 for all, for which the URL contains a token."""
    read_only: bool = False
    """Show everything, but change and save nothing."""
    no_open: bool = False
    """Do not open a browser."""
    set: tuple[str, ...] = ()
    """KEY=VALUE ...: arguments of the source, such as actions=random."""
    extrinsics: Path | None = None
    """A file with the pose of the camera in the base frame."""
    depth: Path | None = None
    """The depth of a photo, aligned to it: 16-bit PNG in millimetres, or .npy (uint16 mm, float m)."""
    intrinsics: tuple[float, float, float, float] | None = None
    """fx fy cx cy of a photo in pixels; with --depth it gives 3D points."""


def main(argv: Sequence[str]) -> int:
    """Run the command and return the exit code."""
    args = tyro.cli(Arguments, args=list(argv), prog="shape-obs tune")
    if not 0 <= args.port <= 65535:
        raise ValueError(f"--port: expected 0...65535, got {args.port}.")
    with warnings_as_lines("shape-obs tune"):
        return _tune(args)


def _tune(args: Arguments) -> int:
    from shape_obs.config.config_file import load_config
    from shape_obs.tuner.engine import Engine
    from shape_obs.tuner.server import Address, open_browser, serve
    from shape_obs.tuner.session import Session

    config = None if args.config is None else load_config(args.config)
    address = Address(args.host, args.port)
    save = args.save or args.config or Path("shape.yaml")

    def announce(url: str) -> None:
        print(f"Open {url} to tune {args.source}; Ctrl-C ends it.", flush=True)
        if not args.no_open:
            open_browser(url)

    with address.bind() as listening:
        engine = Engine(_open(args), Session(config, read_only=args.read_only))
        try:
            engine.start()
            serve(engine, save, address.host, listening, announce)
        finally:
            engine.stop()
    return 0


def _open(args: Arguments) -> RGBDSource:
    """Make the source; a single photo is a source of one frame."""
    from shape_obs_envs.sources.photo import PhotoSource
    from shape_obs_envs.sources.sequence import PHOTOS

    path = Path(args.source)
    if path.suffix.lower() in PHOTOS and not path.is_dir():
        return PhotoSource(path, args.extrinsics, depth=args.depth, intrinsics=args.intrinsics)
    if args.depth is not None or args.intrinsics is not None:
        print("shape-obs tune: --depth and --intrinsics belong to a photo; they are ignored.", file=sys.stderr)
    return open_named(args.source, args.extrinsics, args.set)
