"""``shape-obs detect``: the shape in image files."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from tqdm import tqdm

from shape_obs.camera import Intrinsics
from shape_obs.cli.files import make_folder, read_depth, read_image, write_image
from shape_obs.config import detector_arguments, load_config, save_config
from shape_obs.configurations import Configuration
from shape_obs.detector import ShapeDetector
from shape_obs.drawing import draw_detection
from shape_obs.image.colour_picker import propose_hsv
from shape_obs.image.segmentation import HSVRange


@dataclass(frozen=True)
class Arguments:
    """Find the shape in image files.

    Prints one JSON object per image and line to stdout, and draws the points over each image into a folder. Exit code
    1 if any file could not be read or any shape was not found.

    Say how the object looks in one of three ways: --config, --hsv or --pick.
    """

    images: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Image files."""
    depth: tuple[Path, ...] = ()
    """Depth files, one for each image and aligned to it: 16-bit PNG in millimetres, or .npy (uint16 mm, float m)."""
    intrinsics: tuple[float, float, float, float] | None = None
    """fx fy cx cy of the images in pixels; with --depth it gives 3D points."""
    config: Path | None = None
    """A YAML config file, as --pick writes one."""
    hsv: tuple[int, int, int, int, int, int] | None = None
    """The object's colour: low h s v, high h s v (h 0...179, s and v 0...255; red wraps around: 170 ... 10 ...)."""
    pick: str | None = None
    """u,v: a pixel on the object in the first image; proposes the HSV range and writes it to --save-config."""
    save_config: Path = Path("shape.yaml")
    """Where --pick writes the config."""
    n: int | None = None
    """How many points; default the config's, or 20."""
    ends: str | None = None
    """'centers' of equal pieces, or 'tips': first and last point on the object's ends."""
    out: Path = Path("overlays")
    """Folder for the pictures."""
    track: bool = False
    """The images are one sequence: keep the index from one to the next."""


def main(argv: Sequence[str]) -> int:
    """Run the command; returns the exit code."""
    args = tyro.cli(Arguments, args=list(argv), prog="shape-obs detect")
    if args.depth and len(args.depth) != len(args.images):
        raise ValueError(f"got {len(args.images)} images but {len(args.depth)} depth files; give one for each.")
    if args.depth and args.intrinsics is None:
        raise ValueError("--depth needs --intrinsics FX FY CX CY, or it cannot become metres.")
    _check_unique_names(args.images)
    detector = ShapeDetector(**_detector_arguments(args))
    out = make_folder(args.out)
    failed = 0
    for i, path in enumerate(tqdm(args.images, unit="image", disable=len(args.images) == 1)):
        result = _detect(detector, args, i, out)
        failed += not result.get("ok", False)
        if "error" in result:
            tqdm.write(f"shape-obs detect: {result['error']}", file=sys.stderr)
        print(json.dumps({"image": str(path), **result}), flush=True)
    return 1 if failed else 0


def _detect(detector: ShapeDetector, args: Arguments, i: int, out: Path) -> dict[str, Any]:
    """One image; what is wrong with it becomes part of the result, so that the others are still looked at."""
    path = args.images[i]
    try:
        rgb = read_image(path)
        depth = read_depth(args.depth[i]) if args.depth else None
        camera = None
        if args.intrinsics is not None:
            camera = Intrinsics(rgb.shape[1], rgb.shape[0], *args.intrinsics)
        if not args.track:
            detector.reset()
        detection = detector.detect(rgb, depth, camera)
    except (ValueError, TypeError, OSError) as error:
        return {"ok": False, "error": str(error)}
    overlay = out / f"{path.stem}.png"
    write_image(overlay, draw_detection(rgb, detection))
    return {**detection.to_dict(), "overlay": str(overlay)}


def _detector_arguments(args: Arguments) -> dict[str, Any]:
    """The detector that the options ask for."""
    ways = [name for name in ("config", "hsv", "pick") if getattr(args, name) is not None]
    if len(ways) != 1:
        raise ValueError(f"give exactly one of --config FILE, --hsv ... or --pick u,v; got {ways or 'none'}.")
    arguments: dict[str, Any]
    if args.config is not None:
        arguments = detector_arguments(load_config(args.config))
    elif args.hsv is not None:
        arguments = {"segmentation": HSVRange(args.hsv[:3], args.hsv[3:])}
    else:
        arguments = {"segmentation": propose_hsv(read_image(args.images[0]), _pixel(args.pick or ""))}
    if args.ends is not None:
        arguments["ends"] = args.ends
    if args.n is not None:
        shapes = arguments.get("shapes", [{"kind": "centerline"}])
        arguments["shapes"] = [{**Configuration.from_dict(shape).to_dict(), "n": args.n} for shape in shapes]
    if args.pick is not None:
        save_config(args.save_config, arguments)
        print(f"wrote {args.save_config}: {arguments['segmentation'].to_dict()}", file=sys.stderr)
    return arguments


def _pixel(text: str) -> tuple[float, float]:
    parts = text.split(",")
    try:
        u, v = (float(part) for part in parts)
    except ValueError:
        raise ValueError(f"--pick: expected u,v such as 300,123, got {text!r}.") from None
    return u, v


def _check_unique_names(images: Sequence[Path]) -> None:
    """Two images of one name would overwrite each other's picture."""
    names = [path.stem for path in images]
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise ValueError(f"several images are named {sorted(twice)[0]!r}; their pictures would overwrite each other.")
