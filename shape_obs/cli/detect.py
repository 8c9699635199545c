"""``shape-obs detect``: find the shape in image files."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from tyro.conf import UseAppendAction

from shape_obs.cli.options import warnings_as_lines
from shape_obs.cli.outputs import Overwrite, check_outputs, note_output
from shape_obs.cli.parsing import Option, parse, wrong_usage
from shape_obs.utils.errors import UsageError

if TYPE_CHECKING:
    from shape_obs.configurations.base import Configuration
    from shape_obs.detector import ShapeDetector
    from shape_obs.image.segmentation import Segmentation

#: Low and high hue, saturation and value.
_Bounds: TypeAlias = tuple[int, int, int, int, int, int]


@dataclass(frozen=True)
class Arguments:
    """Find the shape in image files.

    Prints one line of JSON per image to stdout and a readable line to stderr, and writes each image with the points
    drawn over it to a folder. The exit code is 1 if a file could not be read or a shape was not found.

    Describe how the object looks with one of --config, --hsv, --segmentation and --pick.
    """

    images: Annotated[tuple[Path, ...], Option("IMAGE ...", positional=True)]
    """Image files."""
    config: Annotated[Path | None, Option("FILE", "object", existing="config file")] = None
    """A YAML config file, as --pick writes it."""
    hsv: Annotated[_Bounds | None, Option("H S V H S V", "object", least=0, most=255)] = None
    """The object's colour: low h s v, high h s v (h 0...179, s and v 0...255; red wraps around: 170 ... 10 ...)."""
    segmentation: Annotated[str | None, Option("MODULE:FUNCTION", "object")] = None
    """Your own function (rgb, depth) -> mask, which returns the object's pixels; modules in the current folder are
    found."""
    pick: Annotated[tuple[str, ...], Option("U,V", "object"), UseAppendAction] = ()
    """A pixel on the object in the first image; may be repeated. The colours of the object are learned and written to
    --save-config."""
    not_: Annotated[tuple[str, ...], Option("U,V", "object"), UseAppendAction] = ()
    """A pixel that is not on the object but is matched by --pick alone; may be repeated."""
    shape: Annotated[Literal["centerline", "contour", "surface"] | None, Option(group="shape")] = None
    """Form of the object: 'centerline' for ropes and cables, 'contour' for outlines, 'surface' for cloth. Default: the
    shapes of the config, or 'centerline'."""
    n: Annotated[str | None, Option("N|ROWSxCOLUMNS", "shape")] = None
    """Number of points; of a surface, rows and columns such as 4x8. Default: as in the config, or 20."""
    ends: Annotated[Literal["centers", "tips"] | None, Option(group="shape")] = None
    """'centers': points at the centres of equal pieces; 'tips': first and last point on the ends of the object."""
    count: Annotated[str | None, Option("K|all", "shape")] = None
    """How many objects of one colour to find, each in its own slot: a number, or 'all'."""
    depth: Annotated[tuple[Path, ...], Option("FILE ...", "image")] = ()
    """Depth files, one per image and aligned to it: 16-bit PNG in millimetres, or .npy (uint16 mm, float m)."""
    intrinsics: Annotated[tuple[float, float, float, float] | None, Option("FX FY CX CY", "image")] = None
    """fx fy cx cy of the images in pixels; needed with --depth, for 3D points."""
    track: Annotated[bool, Option(group="image")] = False
    """Treat the images as one sequence: each point keeps its index from image to image."""
    out: Annotated[Path, Option("FOLDER", "output")] = Path("overlays")
    """Folder for the pictures."""
    save_config: Annotated[Path, Option("FILE", "output")] = Path("shape.yaml")
    """The file that --pick writes."""
    overwrite: Overwrite = False
    """Replace existing files; unchanged pictures of earlier runs are replaced in any case."""


def main(argv: Sequence[str]) -> int:
    """Run the command and return the exit code."""
    args = parse(Arguments, argv, "shape-obs detect", _check)
    check_outputs(args, *(_overlay(args, path) for path in args.images), args.save_config if args.pick else None)
    from shape_obs.detector import ShapeDetector

    detector = ShapeDetector(**_detector_arguments(args))
    failed = 0
    for i, path in enumerate(_with_progress(args.images)):
        with warnings_as_lines("shape-obs detect"):
            result = _detect(detector, args, i)
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


def _check(args: Arguments) -> None:
    """Reject options that do not go together, before anything slow is imported."""
    ways = [f"--{name}" for name in ("config", "hsv", "segmentation", "pick") if getattr(args, name) not in (None, ())]
    if len(ways) != 1:
        got = " and ".join(ways) or "none"
        raise UsageError(
            f"give exactly one of --config FILE, --hsv ..., --segmentation module:function or --pick u,v; got {got}."
        )
    if args.segmentation is not None and ":" not in args.segmentation:
        raise UsageError(f"--segmentation: expected module:function, got {args.segmentation!r}.")
    if args.depth and len(args.depth) != len(args.images):
        raise UsageError(f"got {len(args.images)} images but {len(args.depth)} depth files; give one per image.")
    if args.depth and args.intrinsics is None:
        raise UsageError("--depth needs --intrinsics FX FY CX CY, which turn depth into 3D points.")
    if args.not_ and not args.pick:
        raise UsageError("--not needs --pick u,v: a pixel on the object.")
    if args.save_config != Arguments.save_config and not args.pick:
        raise UsageError("--save-config needs --pick u,v, which learns what is saved.")
    if args.ends is not None and args.shape == "contour":
        raise UsageError("--ends: an outline has none; leave it out.")
    _pixels(args.pick, "--pick")
    _pixels(args.not_, "--not")
    if args.config is None:
        _size(args.n, args.shape or "centerline")
    _count(args.count)


def _overlay(args: Arguments, image: Path) -> Path:
    return args.out / f"{image.stem}.png"


def _with_progress(images: tuple[Path, ...]) -> Iterable[Path]:
    """Show a progress bar while several images are read."""
    if len(images) == 1:
        return images
    from tqdm import tqdm  # its import takes as long as a few images

    return tqdm(images, unit="image")


def _detect(detector: ShapeDetector, args: Arguments, i: int) -> dict[str, Any]:
    """Detect the shape in one image; an error becomes part of the result, so that the other images are processed."""
    from shape_obs.camera import Intrinsics
    from shape_obs.drawing import draw_detection, legible_scale
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
    overlay = _overlay(args, path)
    write_image(overlay, draw_detection(rgb, detection, scale=legible_scale(rgb)))
    note_output(overlay)
    return {**detection.to_dict(), "overlay": str(overlay)}


def _detector_arguments(args: Arguments) -> dict[str, Any]:
    """Return the arguments of the detector that the options describe."""
    from shape_obs.config.config_file import detector_arguments, load_config, save_config
    from shape_obs.configurations.base import Configuration
    from shape_obs.image.segmentation import HSVRange
    from shape_obs.utils.files import make_folder

    arguments: dict[str, Any]
    if args.config is not None:
        arguments = detector_arguments(load_config(args.config))
    elif args.hsv is not None:
        with wrong_usage():
            arguments = {"segmentation": HSVRange(args.hsv[:3], args.hsv[3:])}
    elif args.segmentation is not None:
        arguments = {"segmentation": args.segmentation}
    else:
        arguments = {"segmentation": _proposed(args)}
    if args.ends is not None:
        arguments["ends"] = args.ends
    if args.shape is not None:
        arguments["shapes"] = [{"kind": args.shape}]
    if args.n is not None or args.count is not None:
        shapes = map(Configuration.from_dict, arguments.get("shapes", [{"kind": "centerline"}]))
        arguments["shapes"] = [_changed(shape, args) for shape in shapes]
    make_folder(args.out)  # --save-config may lie in it
    if args.pick:
        save_config(args.save_config, arguments)
        print(f"shape-obs detect: wrote {args.save_config}", file=sys.stderr)
    return arguments


def _proposed(args: Arguments) -> Segmentation:
    """Return the segmentation that the picked pixels of the first image mean, and print what was found."""
    from shape_obs.clicks import propose_segmentation
    from shape_obs.utils.arrays import read_depth, read_image

    depth = read_depth(args.depth[0]) if args.depth else None
    picks, nots = _pixels(args.pick, "--pick"), _pixels(args.not_, "--not")
    proposal = propose_segmentation(read_image(args.images[0]), picks, nots, depth)
    print(f"shape-obs detect: {proposal.text}", file=sys.stderr)
    return proposal.rule


def _changed(shape: Configuration, args: Arguments) -> Configuration:
    """Return a configuration with the number of points and of objects that the user chose."""
    count = {} if args.count is None else {"count": _count(args.count)}
    with wrong_usage():
        return shape.from_dict({**shape.to_dict(), **_size(args.n, shape.kind), **count})


def _size(text: str | None, kind: str) -> dict[str, int]:
    """Return the number of points that ``--n`` gives to a shape of this kind, as its arguments."""
    if text is None:
        return {}
    numbers = text.lower().split("x")
    if not all(number.isdigit() for number in numbers) or len(numbers) > 2:
        raise UsageError(f"--n: expected a number of points such as 20, or ROWSxCOLUMNS such as 4x8, got {text!r}.")
    if kind == "surface" and len(numbers) == 1:
        raise UsageError(f"--n: a surface has rows and columns: expected ROWSxCOLUMNS such as 4x8, got {text!r}.")
    if kind != "surface" and len(numbers) == 2:
        raise UsageError(f"--n: a {kind} has one number of points such as 20, got {text!r}; see --shape surface.")
    return dict(zip(("rows", "cols") if kind == "surface" else ("n",), map(int, numbers), strict=True))


def _count(text: str | None) -> int | str | None:
    if text is None or text == "all":
        return text
    if not text.isdigit():
        raise UsageError(f"--count: expected a number or 'all', got {text!r}.")
    return int(text)


def _pixels(texts: Sequence[str], option: str) -> list[tuple[float, float]]:
    pixels = []
    for text in texts:
        try:
            u, v = (float(part) for part in text.split(","))
        except ValueError:
            raise UsageError(f"{option}: expected u,v such as 300,123, got {text!r}.") from None
        pixels.append((u, v))
    return pixels
