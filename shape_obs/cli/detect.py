"""``shape-obs detect``: find the shape in image files."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from shape_obs.cli.options import warnings_as_lines

if TYPE_CHECKING:
    from shape_obs.detector import ShapeDetector


@dataclass(frozen=True)
class Arguments:
    """Find the shape in image files.

    Prints one line of JSON per image to stdout and one for people to stderr, and writes each image with the points
    drawn over it to a folder. The exit code is 1 if a file could not be read or a shape was not found.

    Describe how the object looks with one of --config, --hsv, --segmentation and --pick.
    """

    images: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Image files."""
    depth: tuple[Path, ...] = ()
    """Depth files, one per image and aligned to it: 16-bit PNG in millimetres, or .npy (uint16 mm, float m)."""
    intrinsics: tuple[float, float, float, float] | None = None
    """fx fy cx cy of the images in pixels; needed with --depth, for 3D points."""
    config: Path | None = None
    """A YAML config file, as --pick writes it."""
    hsv: tuple[int, int, int, int, int, int] | None = None
    """The object's colour: low h s v, high h s v (h 0...179, s and v 0...255; red wraps around: 170 ... 10 ...)."""
    segmentation: str | None = None
    """module:function: your own function (rgb, depth) -> mask; modules in the current folder are found."""
    pick: str | None = None
    """u,v: a pixel on the object in the first image. Proposes an HSV range and writes it to --save-config."""
    save_config: Path = Path("shape.yaml")
    """The file that --pick writes."""
    n: int | None = None
    """Number of points; default: as in the config, or 20."""
    ends: str | None = None
    """'centers': points at the centres of equal pieces; 'tips': first and last point on the ends of the object."""
    count: str | None = None
    """How many objects of one colour to find, each in a slot of its own: a number, or 'all'."""
    out: Path = Path("overlays")
    """Folder for the pictures."""
    track: bool = False
    """Treat the images as one sequence: each point keeps its index from image to image."""


def main(argv: Sequence[str]) -> int:
    """Run the command and return the exit code."""
    args = tyro.cli(Arguments, args=list(argv), prog="shape-obs detect")
    if args.depth and len(args.depth) != len(args.images):
        raise ValueError(f"got {len(args.images)} images but {len(args.depth)} depth files; give one per image.")
    if args.depth and args.intrinsics is None:
        raise ValueError("--depth needs --intrinsics FX FY CX CY, which turn depth into 3D points.")
    _check_unique_names(args.images)
    from shape_obs.detector import ShapeDetector
    from shape_obs.utils.files import make_folder

    detector = ShapeDetector(**_detector_arguments(args))
    out = make_folder(args.out)
    failed = 0
    for i, path in enumerate(_with_progress(args.images)):
        with warnings_as_lines("shape-obs detect"):
            result = _detect(detector, args, i, out)
        failed += not result.get("ok", False)
        _say(_line(path, result), many=len(args.images) > 1)
        print(json.dumps({"image": str(path), **result}), flush=True)
    return 1 if failed else 0


def _line(path: Path, result: Mapping[str, Any]) -> str:
    """Return what was found in an image as one line for people."""
    if "error" in result:
        error = " ".join(result["error"].split())
        return error if error.startswith(str(path)) else f"{path}: {error}"
    shapes = []
    for shape in result["shapes"]:
        if shape["reason"]:
            shapes.append(f"{shape['name']} not found: {shape['reason']}")
            continue
        seen, valid = shape["visible"].count(True), shape["valid"].count(True)
        points = f"{len(shape['visible'])} points"
        points += f", {seen} of them visible" if seen < len(shape["visible"]) else ""
        points += f", {valid} with depth" if shape["points3d"] is not None else ""
        shapes.append(f"{shape['name']} found, quality {shape['quality']:.2f}, {points}")
    return f"{path}: {'; '.join(shapes) or 'nothing found'}; picture: {result['overlay']}"


def _say(line: str, *, many: bool) -> None:
    """Print a line to stderr, above the progress bar if there is one."""
    if many:
        from tqdm import tqdm

        tqdm.write(line, file=sys.stderr)
    else:
        print(line, file=sys.stderr)


def _with_progress(images: tuple[Path, ...]) -> Iterable[Path]:
    """Show a progress bar while several images are read."""
    if len(images) == 1:
        return images
    from tqdm import tqdm  # its import takes as long as a few images

    return tqdm(images, unit="image")


def _detect(detector: ShapeDetector, args: Arguments, i: int, out: Path) -> dict[str, Any]:
    """Detect the shape in one image; an error becomes part of the result, so that the other images are processed."""
    from shape_obs.camera import Intrinsics
    from shape_obs.drawing import draw_detection
    from shape_obs.utils.arrays import read_depth, read_image, write_image

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
    """Return the arguments of the detector that the options describe."""
    from shape_obs.config.config_file import detector_arguments, load_config, save_config
    from shape_obs.configurations.base import Configuration
    from shape_obs.image.colour_picker import propose_hsv
    from shape_obs.image.segmentation import HSVRange
    from shape_obs.utils.arrays import read_image

    ways = [name for name in ("config", "hsv", "segmentation", "pick") if getattr(args, name) is not None]
    if len(ways) != 1:
        raise ValueError(
            "give exactly one of --config FILE, --hsv ..., --segmentation module:function or --pick u,v; got "
            f"{ways or 'none'}."
        )
    arguments: dict[str, Any]
    if args.config is not None:
        arguments = detector_arguments(load_config(args.config))
    elif args.hsv is not None:
        arguments = {"segmentation": HSVRange(args.hsv[:3], args.hsv[3:])}
    elif args.segmentation is not None:
        if ":" not in args.segmentation:
            raise ValueError(f"--segmentation: expected module:function, got {args.segmentation!r}.")
        arguments = {"segmentation": args.segmentation}
    else:
        arguments = {"segmentation": propose_hsv(read_image(args.images[0]), _pixel(args.pick or ""))}
    if args.ends is not None:
        arguments["ends"] = args.ends
    changed = {"n": args.n, "count": _count(args.count)}
    changed = {name: value for name, value in changed.items() if value is not None}
    if changed:
        shapes = arguments.get("shapes", [{"kind": "centerline"}])
        arguments["shapes"] = [{**Configuration.from_dict(shape).to_dict(), **changed} for shape in shapes]
    if args.pick is not None:
        save_config(args.save_config, arguments)
        print(f"wrote {args.save_config}: {arguments['segmentation'].to_dict()}", file=sys.stderr)
    return arguments


def _count(text: str | None) -> int | str | None:
    if text is None or text == "all":
        return text
    if not text.isdigit():
        raise ValueError(f"--count: expected a number or 'all', got {text!r}.")
    return int(text)


def _pixel(text: str) -> tuple[float, float]:
    parts = text.split(",")
    try:
        u, v = (float(part) for part in parts)
    except ValueError:
        raise ValueError(f"--pick: expected u,v such as 300,123, got {text!r}.") from None
    return u, v


def _check_unique_names(images: Sequence[Path]) -> None:
    """Reject images of the same name, which would overwrite each other's picture."""
    names = [path.stem for path in images]
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise ValueError(f"several images are named {sorted(twice)[0]!r}; their pictures would overwrite each other.")
