"""``shape-obs fit-features``: principal components of recorded shapes."""

from __future__ import annotations

import json
from collections.abc import Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import tyro
from tqdm import tqdm

from shape_obs.cli.options import open_named, warnings_as_lines
from shape_obs.config import config_hash, detector_arguments, load_config, schema_hash
from shape_obs.configurations import Configuration
from shape_obs.detector import ShapeDetector
from shape_obs.extrinsics import Extrinsics
from shape_obs.features import PointDistribution, PrincipalComponents, View
from shape_obs.features.coordinates import Coordinates, Frame
from shape_obs.geometry.topology import Topology
from shape_obs.recording import ShapeTable, replay
from shape_obs.recording.format import camera_from_dict
from shape_obs.recording.replay import check_depth
from shape_obs.shape import Shape
from shape_obs.spec import did_you_mean
from shape_obs.utils.documents import parse_yaml

Array = npt.NDArray[np.float64]

_TABLES: Final = (".npz", ".parquet", ".csv")
_HELD_OUT: Final = 5  # every fifth


@dataclass(frozen=True)
class Arguments:
    """Fit principal components to recorded shapes, for the feature 'pca'.

    Shapes that are not ok, or have a point that was not measured, are left out. Every fifth episode, or with fewer
    than five of them every fifth shape, is held out: the error is that of the held-out shapes.
    """

    source: Annotated[tuple[str, ...], tyro.conf.Positional]
    """Tables that `shape-obs replay` wrote (.npz, .parquet, .csv); with --config also what else it replays."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Where the components go, a file *.npz."""
    components: int = 6
    """How many."""
    frame: Frame = "camera"
    """Where the points are measured; 'base' needs the camera's place."""
    origin: str | None = None
    """What they are relative to: 'centroid', or of recordings 'anchor' or an anchor's name; default the frame's own."""
    align: bool = False
    """Take place, heading and size out first, and keep them as values of their own: fewer components do then."""
    name: str | None = None
    """Which shape; default the first."""
    config: Path | None = None
    """A YAML config file, to detect with."""
    extrinsics: Path | None = None
    """A file that says where the camera stands in the base frame; wins over the recorded place."""
    frames: int | None = None
    """How many at most, of each source."""
    set: tuple[str, ...] = ()
    """KEY=VALUE ...: arguments of the sources."""
    json: bool = False
    """Print the summary as JSON."""


class Seen(NamedTuple):
    """A shape and what it was seen in."""

    shape: Shape
    view: View
    episode: tuple[str, int]


@dataclass
class Collected:
    """What was read."""

    points: list[Array] = field(default_factory=list)
    episodes: list[tuple[str, int]] = field(default_factory=list)
    left_out: int = 0
    layout: Topology | None = None

    def add(self, seen: Seen, coordinates: Coordinates) -> None:
        """Take a shape, or leave it out.

        Raises:
            ValueError: Its layout is not that of the others, or it cannot be had in these coordinates.
        """
        shape = seen.shape
        self.layout = self.layout or shape.layout
        if shape.layout != self.layout:
            raise ValueError(f"{seen.episode[0]}: {shape.name!r} is {shape.layout}, but {self.layout} came before.")
        if not shape.ok or not (shape.visible if coordinates.planar else shape.valid).all():
            self.left_out += 1
            return
        points = coordinates.points(shape, seen.view)
        if not np.isfinite(points).all():
            self.left_out += 1
            return
        self.points.append(points)
        self.episodes.append(seen.episode)


def main(argv: Sequence[str]) -> int:
    """Run the command; returns the exit code."""
    args = tyro.cli(Arguments, args=list(argv), prog="shape-obs fit-features")
    if args.out.suffix != ".npz":
        raise ValueError(f"--out: expected a file named *.npz, got {args.out}.")
    if args.frames is not None and args.frames < 1:
        raise ValueError(f"--frames: expected 1 or more, got {args.frames}.")
    if not args.source:
        raise ValueError("give at least one table or recording.")
    coordinates, collected = Coordinates(args.frame, args.origin, kind="pca"), Collected()
    made: dict[str, Any] = {"schema_hashes": [], "config_hashes": []}
    with warnings_as_lines("shape-obs fit-features"):
        for source in args.source:
            shapes = _of_table(args, source, made) if Path(source).suffix in _TABLES else _of_source(args, source, made)
            with closing(shapes):  # the bar is gone before an error is told
                for seen in shapes:
                    collected.add(seen, coordinates)
    result = _fit(args, collected, made)
    print(json.dumps(result) if args.json else summary(result))
    return 0


def summary(result: dict[str, Any]) -> str:
    """The lines that the command prints."""
    error, digits = result["error"], 4 if not result["unit"] else 2
    explained = [f"{100 * part:.2f}" for part in np.cumsum(result["explained"])]
    return "\n".join(
        [
            f"shapes          {result['shapes']} fitted, {result['held_out']} held out, {result['left_out']} left out",
            f"components      {len(explained)}, which explain {', '.join(explained)} %",
            f"error           mean {error['mean']:.{digits}f}, 95th percentile {error['p95']:.{digits}f}, "
            f"largest {error['max']:.{digits}f} {result['unit']}".rstrip(),
            f"wrote           {result['file']}",
        ]
    )


def _fit(args: Arguments, collected: Collected, made: dict[str, Any]) -> dict[str, Any]:
    if len(collected.points) < _HELD_OUT:
        raise ValueError(
            f"only {len(collected.points)} shapes are whole, {collected.left_out} are not: record more of them."
        )
    assert collected.layout is not None
    points, held = np.stack(collected.points), _held_out(collected.episodes)
    model = PointDistribution.fit(
        points[~held], args.components, layout=collected.layout, frame=args.frame, origin=args.origin,
        aligned=args.align, about=made,
    )  # fmt: skip
    scale, unit = (1e3, "mm") if model.unit == "m" else (1.0, model.unit)
    everywhere = np.ones(len(model.mean))
    off = [np.linalg.norm(model.points(model.values(shape, everywhere)) - shape, axis=1) for shape in points[held]]
    error = {"mean": np.mean(off), "p95": np.percentile(off, 95), "max": np.max(off)}
    model.save(args.out)
    return {
        "shapes": int(np.count_nonzero(~held)),
        "held_out": int(np.count_nonzero(held)),
        "left_out": collected.left_out,
        "explained": model.about["explained"],
        "error": {name: round(scale * float(value), 5) for name, value in error.items()},
        "unit": unit,
        "file": str(args.out),
        "sha256": PrincipalComponents(str(args.out)).identity()["sha256"],
    }


def _held_out(episodes: Sequence[tuple[str, int]]) -> npt.NDArray[np.bool_]:
    """(F,) which shapes are held out. Neighbouring frames are alike, so whole episodes are, where there are enough."""
    index = {episode: i for i, episode in enumerate(dict.fromkeys(episodes))}
    places = [index[episode] for episode in episodes] if len(index) >= _HELD_OUT else range(len(episodes))
    return np.array(places) % _HELD_OUT == _HELD_OUT - 1


def _of_table(args: Arguments, source: str, made: dict[str, Any]) -> Generator[Seen, None, None]:
    table = ShapeTable.load(source)
    try:
        shapes = parse_yaml(table.metadata["config"], "config")["shape"]["shapes"]
        layouts = {spec.name: spec.layout for spec in map(Configuration.from_dict, shapes)}
        camera = camera_from_dict(table.metadata["camera"] or {"intrinsics": None, "transform_camera_to_base": None})
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{source}: its metadata lack shapes or camera ({error}): replay it again.") from error
    _note(made, table.metadata.get("schema_hash"), table.metadata.get("config_hash"))
    name = _chosen(args.name, list(layouts), source)
    if args.extrinsics is not None and camera is not None:
        camera = Extrinsics.load(args.extrinsics).camera(camera.intrinsics)
    if camera is None and args.frame in ("normalized", "base"):
        raise ValueError(f"{source}: --frame {args.frame} needs the camera's intrinsics, and the table has none.")
    height, width = (1, 1) if camera is None else camera.intrinsics.size
    view, columns = View(width, height, camera), table.columns
    for i in _bar(range(min(args.frames or len(table), len(table))), source):
        row = {key: columns[f"{name}/{key}"][i] for key in ("points2d", "points3d") if f"{name}/{key}" in columns}
        shape = Shape(
            name, row.get("points2d"), row.get("points3d"), columns[f"{name}/visible"][i], columns[f"{name}/valid"][i],
            layouts[name], ok=bool(columns[f"{name}/ok"][i]),
        )  # fmt: skip
        yield Seen(shape, view, (source, int(columns["episode"][i])))


def _of_source(args: Arguments, source: str, made: dict[str, Any]) -> Generator[Seen, None, None]:
    from shape_obs.wrappers.env_protocol import base_point

    if args.config is None:
        raise ValueError(f"{source} is no table (.npz, .parquet, .csv): give --config FILE to find shapes in it.")
    arguments = load_config(args.config)
    detector = ShapeDetector(**{**detector_arguments(arguments), "on_missing": "nan"})
    _note(made, schema_hash(arguments), config_hash(arguments))
    name = _chosen(args.name, [spec.name for spec in detector.shapes], str(args.config))
    spec = next(spec for spec in detector.shapes if spec.name == name)
    with open_named(source, args.extrinsics, args.set) as opened:
        if opened.kind in ("d455", "software", "env") and args.frames is None:
            raise ValueError(f"{opened.name} never ends: give --frames N.")
        check_depth(opened, detector, arguments)
        length = args.frames or (len(opened) if hasattr(opened, "__len__") else None)  # pyright: ignore[reportArgumentType]
        for moment, detection in _bar(replay(opened, detector, args.frames), source, length):
            height, width = moment.frame.size or (1, 1)
            anchor = base_point(spec, moment.anchors)
            view = View(width, height, moment.frame.camera, anchor=anchor, anchors=moment.anchors)
            yield Seen(detection[name], view, (source, moment.episode))


def _bar(what: Iterable[Any], source: str, length: int | None = None) -> tqdm:
    return tqdm(what, total=length, unit="frame", leave=False, desc=f"reading {source}")


def _note(made: dict[str, Any], *hashes: str | None) -> None:
    """What the shapes were detected with; not where they lie, so that equal shapes make equal files anywhere."""
    for told, new in zip(made.values(), hashes, strict=True):
        if new not in told:
            told.append(new)


def _chosen(name: str | None, known: Sequence[str], where: str) -> str:
    if name is not None and name not in known:
        raise ValueError(f"--name: {where} has no shape {name!r}{did_you_mean(name, known)}")
    return name or known[0]
