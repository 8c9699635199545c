"""``shape-obs tune``: choose the settings of a detector on a web page, from what a camera or a file shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from shape_obs.cli.options import check_source, open_named, read_settings, warnings_as_lines
from shape_obs.cli.outputs import Overwrite, check_outputs
from shape_obs.cli.parsing import Option, parse
from shape_obs.utils.errors import UsageError, ending

if TYPE_CHECKING:
    from shape_obs.source import RGBDSource

#: ``shape_obs_envs.sources.sequence.PHOTOS``, repeated here because arguments are checked before OpenCV is imported.
PHOTOS: Final = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")


@dataclass(frozen=True)
class Arguments:
    """Choose the settings of a detector on a web page, and save them as the YAML file that every command reads.

    Prints the URL of the page and serves it until Ctrl-C. Only this machine can open it, unless --host is given.
    """

    source: Annotated[str, Option("SOURCE", positional=True, check=check_source)]
    """A photo, a video, a folder of photos, a recording, d455[:serial], webcam:0, module:Class, FILE.db3, FILE.bag,
    FILE.mcap, or the id of an environment."""
    config: Annotated[Path | None, Option("FILE", "settings", existing="config file")] = None
    """A YAML config file to start with."""
    read_only: Annotated[bool, Option(group="settings")] = False
    """Show everything, but change and save nothing."""
    save: Annotated[Path | None, Option("FILE", "output")] = None
    """The YAML file that Save writes; by default --config, or shape.yaml."""
    overwrite: Overwrite = False
    """Replace existing files."""
    port: Annotated[int, Option("N", "page", least=0, most=65535)] = 8600
    """Port of the page; 0 for any free port."""
    host: Annotated[str, Option("ADDRESS", "page")] = "127.0.0.1"
    """Network interface that serves the page; 0.0.0.0 for all. The URL then contains a token, without which requests
    are refused."""
    no_open: Annotated[bool, Option(group="page")] = False
    """Do not open a browser."""
    set: Annotated[tuple[str, ...], Option("KEY=VALUE ...", "source", check=read_settings)] = ()
    """Arguments of the source, such as actions=random."""
    extrinsics: Annotated[Path | None, Option("FILE", "source", existing="file of extrinsics")] = None
    """A file with the pose of the camera in the base frame."""
    depth: Annotated[Path | None, Option("FILE", "source", existing="depth file")] = None
    """The depth of a photo, aligned to it: 16-bit PNG in millimetres, or .npy (uint16 mm, float m)."""
    intrinsics: Annotated[tuple[float, float, float, float] | None, Option("FX FY CX CY", "source")] = None
    """fx fy cx cy of a photo in pixels; needed with --depth, for 3D points."""


def main(argv: Sequence[str]) -> int:
    """Run the command and return the exit code."""
    args = parse(Arguments, argv, "shape-obs tune", _check)
    save = args.save or args.config or Path("shape.yaml")
    if not args.read_only and not (args.config is not None and save.exists() and save.samefile(args.config)):
        check_outputs(args, save, hint=f"; --config {save} goes on with it")
    with warnings_as_lines("shape-obs tune"):
        return _tune(args, save)


def _check(args: Arguments) -> None:
    if not _is_photo(args) and (args.depth is not None or args.intrinsics is not None):
        raise UsageError("--depth and --intrinsics belong to a photo; other sources bring their own.")
    if args.depth is not None and args.intrinsics is None:
        raise UsageError("--depth needs --intrinsics FX FY CX CY, which turn depth into 3D points.")
    if _is_photo(args) and args.extrinsics is not None and args.intrinsics is None:
        raise UsageError("--extrinsics of a photo needs --intrinsics FX FY CX CY.")


def _is_photo(args: Arguments) -> bool:
    path = Path(args.source)
    return path.suffix.lower() in PHOTOS and not path.is_dir()


def _tune(args: Arguments, save: Path) -> int:
    from shape_obs.config.config_file import load_config
    from shape_obs.tuner.engine import Engine
    from shape_obs.tuner.server import Address, open_browser, serve
    from shape_obs.tuner.session import Session

    config = None if args.config is None else load_config(args.config)
    address = Address(args.host, args.port)
    before = save.read_bytes() if save.is_file() else b""

    def announce(url: str) -> None:
        print(f"Open {url} to tune {args.source}; Ctrl-C ends it.", flush=True)
        if not args.no_open:
            open_browser(url)

    with address.bind() as listening:
        engine = Engine(_open(args), Session(config, read_only=args.read_only, saved=before))
        with ending(engine.stop):
            engine.start()
            serve(engine, save, address.host, listening, announce)
    return 0


def _open(args: Arguments) -> RGBDSource:
    """Make the source; a single photo is a source of one frame."""
    if not _is_photo(args):
        return open_named(args.source, args.extrinsics, args.set)
    from shape_obs_envs.sources.photo import PhotoSource

    return PhotoSource(Path(args.source), args.extrinsics, depth=args.depth, intrinsics=args.intrinsics)
