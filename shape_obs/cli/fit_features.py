"""``shape-obs fit-features``: fit principal components to recorded shapes."""

from __future__ import annotations

import json
from collections.abc import Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, NamedTuple

from shape_obs.cli.options import open_named, read_settings, warnings_as_lines
from shape_obs.cli.outputs import Overwrite, check_outputs
from shape_obs.cli.parsing import Option, parse, wrong_usage
from shape_obs.utils.documents import parse_yaml
from shape_obs.utils.errors import UsageError, did_you_mean

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt
    from tqdm import tqdm

    from shape_obs.features import FeatureContext
    from shape_obs.features.coordinates import Coordinates
    from shape_obs.geometry.topology import Topology
    from shape_obs.shape import Shape

_TABLES: Final = (".npz", ".parquet", ".csv")
_HELD_OUT: Final = 5  # every fifth episode or shape


@dataclass(frozen=True)
class Arguments:
    """Fit principal components to recorded shapes, for the feature 'pca'.

    Shapes that are not ok, or have a point that was not measured, are skipped. Every fifth episode is held out, or
    every fifth shape if there are fewer than five episodes; the reported error is that of the held-out shapes.
    """

    source: Annotated[tuple[str, ...], Option("TABLE ...", positional=True)]
    """Tables that `shape-obs replay` wrote (.npz, .parquet, .csv); with --config also any recording it can replay."""
    out: Annotated[Path, Option("FILE", "output", "-o")]
    """The file for the components, *.npz."""
    components: Annotated[int, Option("N", "components", least=1)] = 6
    """Number of components."""
    frame: Annotated[Literal["pixels", "normalized", "camera", "base"], Option(group="components")] = "camera"
    """Coordinate frame of the points; 'base' needs the pose of the camera."""
    origin: Annotated[str | None, Option("NAME", "components")] = None
    """Origin of the points: 'centroid'; for recordings also 'anchor' or an anchor's name; default: the frame's own."""
    align: Annotated[bool, Option(group="components")] = False
    """Remove position, heading and size first and keep them as separate values, so that fewer components suffice."""
    name: Annotated[str | None, Option("SHAPE", "source")] = None
    """Name of the shape; default: the first."""
    config: Annotated[Path | None, Option("FILE", "source", existing="config file")] = None
    """A YAML config file, to find shapes in recordings."""
    extrinsics: Annotated[Path | None, Option("FILE", "source", existing="file of extrinsics")] = None
    """A file with the pose of the camera in the base frame; replaces the recorded pose."""
    frames: Annotated[int | None, Option("N", "source", least=1)] = None
    """Largest number of frames from each source."""
    set: Annotated[tuple[str, ...], Option("KEY=VALUE ...", "source", check=read_settings)] = ()
    """Arguments of the sources."""
    overwrite: Overwrite = False
    """Replace existing files."""
    json: Annotated[bool, Option(group="output")] = False
    """Print the summary as JSON."""


class Sample(NamedTuple):
    """A recorded shape, its context and its episode."""

    shape: Shape
    context: FeatureContext
    episode: tuple[str, int]


@dataclass
class Samples:
    """The shapes that are complete enough for a fit."""

    points: list[npt.NDArray[np.float64]] = field(default_factory=list)
    episodes: list[tuple[str, int]] = field(default_factory=list)
    skipped: int = 0
    layout: Topology | None = None

    def add(self, sample: Sample, coordinates: Coordinates) -> None:
        """Add a shape, or skip it if some of its points were not measured.

        Raises:
            ValueError: Its layout differs from that of the other shapes, or it has no such coordinates.
        """
        import numpy as np

        shape = sample.shape
        self.layout = self.layout or shape.layout
        if shape.layout != self.layout:
            raise ValueError(f"{sample.episode[0]}: {shape.name!r} is {shape.layout}, but {self.layout} came before.")
        if not shape.ok or not (shape.visible if coordinates.planar else shape.valid).all():
            self.skipped += 1
            return
        points = coordinates.points(shape, sample.context)
        if not np.isfinite(points).all():
            self.skipped += 1
            return
        self.points.append(points)
        self.episodes.append(sample.episode)


def main(argv: Sequence[str]) -> int:
    """Run the command and return the exit code."""
    args = parse(Arguments, argv, "shape-obs fit-features")
    if args.out.suffix != ".npz":
        raise UsageError(f"--out: expected a file named *.npz, got {args.out}.")
    recordings = [source for source in args.source if Path(source).suffix not in _TABLES]
    if recordings and args.config is None:
        raise UsageError(
            f"{recordings[0]} is not a table (.npz, .parquet, .csv): give --config FILE to find shapes in it."
        )
    if args.set and not recordings:
        raise UsageError("--set is for recordings; a table takes no arguments.")
    for source in args.source:
        if source not in recordings and not Path(source).is_file():
            raise FileNotFoundError(f"{source}: no such file.")
    check_outputs(args, args.out)
    from shape_obs.features.coordinates import Coordinates

    with wrong_usage():
        coordinates, samples = Coordinates(args.frame, args.origin, kind="pca"), Samples()
    hashes: dict[str, Any] = {"schema_hashes": [], "config_hashes": []}
    with warnings_as_lines("shape-obs fit-features"):
        for source in args.source:
            read = _read_table if Path(source).suffix in _TABLES else _read_recording
            with closing(read(args, source, hashes)) as found:  # closes the progress bar before an error is printed
                for sample in found:
                    samples.add(sample, coordinates)
    result = _fit(args, samples, hashes)
    print(json.dumps(result) if args.json else summary(result))
    return 0


def summary(result: dict[str, Any]) -> str:
    """Return the lines that the command prints."""
    import numpy as np

    error, digits = result["error"], 4 if not result["unit"] else 2
    explained = [f"{100 * part:.2f}" for part in np.cumsum(result["explained"])]
    return "\n".join(
        [
            f"shapes          {result['shapes']} fitted, {result['held_out']} held out, {result['left_out']} skipped",
            f"components      {len(explained)}, together explaining {', '.join(explained)} %",
            f"error           mean {error['mean']:.{digits}f}, 95th percentile {error['p95']:.{digits}f}, "
            f"largest {error['max']:.{digits}f} {result['unit']}".rstrip(),
            f"wrote           {result['file']}",
        ]
    )


def _fit(args: Arguments, samples: Samples, hashes: dict[str, Any]) -> dict[str, Any]:
    import numpy as np

    from shape_obs.features import PointDistribution, PrincipalComponents

    if len(samples.points) < _HELD_OUT:
        raise ValueError(
            f"only {len(samples.points)} shapes are complete, {samples.skipped} are not: record more shapes."
        )
    assert samples.layout is not None
    points, held = np.stack(samples.points), _held_out(samples.episodes)
    model = PointDistribution.fit(
        points[~held], args.components, layout=samples.layout, frame=args.frame, origin=args.origin,
        aligned=args.align, about=hashes,
    )  # fmt: skip
    scale, unit = (1e3, "mm") if model.unit == "m" else (1.0, model.unit)
    everywhere = np.ones(len(model.mean))
    off = [np.linalg.norm(model.points(model.values(shape, everywhere)) - shape, axis=1) for shape in points[held]]
    error = {"mean": np.mean(off), "p95": np.percentile(off, 95), "max": np.max(off)}
    model.save(args.out)
    return {
        "shapes": int(np.count_nonzero(~held)),
        "held_out": int(np.count_nonzero(held)),
        "left_out": samples.skipped,
        "explained": model.about["explained"],
        "error": {name: round(scale * float(value), 5) for name, value in error.items()},
        "unit": unit,
        "file": str(args.out),
        "sha256": PrincipalComponents(str(args.out)).identity()["sha256"],
    }


def _held_out(episodes: Sequence[tuple[str, int]]) -> npt.NDArray[np.bool_]:
    """Return which shapes are held out, of shape ``(F,)``.

    Neighbouring frames are similar, so whole episodes are held out if there are enough of them.
    """
    import numpy as np

    index = {episode: i for i, episode in enumerate(dict.fromkeys(episodes))}
    places = [index[episode] for episode in episodes] if len(index) >= _HELD_OUT else range(len(episodes))
    return np.array(places) % _HELD_OUT == _HELD_OUT - 1


def _read_table(args: Arguments, source: str, hashes: dict[str, Any]) -> Generator[Sample, None, None]:
    """Yield the shapes of a table that ``shape-obs replay`` wrote."""
    from shape_obs.configurations.base import Configuration
    from shape_obs.extrinsics import Extrinsics
    from shape_obs.features import FeatureContext
    from shape_obs.recording import ShapeTable
    from shape_obs.recording.format import camera_from_dict
    from shape_obs.shape import Shape

    table = ShapeTable.load(source)
    try:
        shapes = parse_yaml(table.metadata["config"], "config")["shape"]["shapes"]
        layouts = {spec.name: spec.layout for spec in map(Configuration.from_dict, shapes)}
        camera = camera_from_dict(table.metadata["camera"] or {"intrinsics": None, "transform_camera_to_base": None})
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{source}: its metadata have no shapes or no camera ({error}): replay it again.") from error
    _note(hashes, table.metadata.get("schema_hash"), table.metadata.get("config_hash"))
    name = _chosen(args.name, list(layouts), source)
    if args.extrinsics is not None and camera is not None:
        camera = Extrinsics.load(args.extrinsics).camera(camera.intrinsics)
    if camera is None and args.frame in ("normalized", "base"):
        raise ValueError(f"{source}: --frame {args.frame} needs the camera's intrinsics, and the table has none.")
    height, width = (1, 1) if camera is None else camera.intrinsics.size
    context, columns = FeatureContext(width, height, camera), table.columns
    for i in _bar(range(min(args.frames or len(table), len(table))), source):
        row = {key: columns[f"{name}/{key}"][i] for key in ("points2d", "points3d") if f"{name}/{key}" in columns}
        shape = Shape(
            name, row.get("points2d"), row.get("points3d"), columns[f"{name}/visible"][i], columns[f"{name}/valid"][i],
            layouts[name], ok=bool(columns[f"{name}/ok"][i]),
        )  # fmt: skip
        yield Sample(shape, context, (source, int(columns["episode"][i])))


def _read_recording(args: Arguments, source: str, hashes: dict[str, Any]) -> Generator[Sample, None, None]:
    """Yield the shapes that the detector finds in a recording."""
    from shape_obs.config.config_file import config_hash, detector_arguments, load_config, schema_hash
    from shape_obs.detector import ShapeDetector
    from shape_obs.features import FeatureContext
    from shape_obs.recording import replay
    from shape_obs.recording.replay import check_depth
    from shape_obs.wrappers.env_protocol import base_point

    assert args.config is not None  # checked before anything is read
    arguments = load_config(args.config)
    detector = ShapeDetector(**{**detector_arguments(arguments), "on_missing": "nan"})
    _note(hashes, schema_hash(arguments), config_hash(arguments))
    name = _chosen(args.name, [spec.name for spec in detector.shapes], str(args.config))
    spec = next(spec for spec in detector.shapes if spec.name == name)
    with open_named(source, args.extrinsics, args.set) as opened:
        if (opened.live or opened.kind == "env") and args.frames is None:
            raise UsageError(f"{opened.name} never ends: give --frames N.")
        check_depth(opened, detector, arguments)
        length = args.frames or (len(opened) if hasattr(opened, "__len__") else None)  # pyright: ignore[reportArgumentType]
        for moment, detection in _bar(replay(opened, detector, args.frames), source, length):
            height, width = moment.frame.size or (1, 1)
            anchor = base_point(spec, moment.anchors)
            context = FeatureContext(width, height, moment.frame.camera, anchor=anchor, anchors=moment.anchors)
            yield Sample(detection[name], context, (source, moment.episode))


def _bar(what: Iterable[Any], source: str, length: int | None = None) -> tqdm:
    from tqdm import tqdm

    return tqdm(what, total=length, unit="frame", leave=False, desc=f"reading {source}")


def _note(hashes: dict[str, Any], *new: str | None) -> None:
    """Store the hashes of the detector's config; no paths, so that equal shapes give equal files everywhere."""
    for known, each in zip(hashes.values(), new, strict=True):
        if each not in known:
            known.append(each)


def _chosen(name: str | None, known: Sequence[str], where: str) -> str:
    if name is not None and name not in known:
        raise UsageError(f"--name: {where} has no shape {name!r}{did_you_mean(name, known)}")
    return name or known[0]
