"""Write recorded ropes to files, track them from these files, and score the points that any tracker found in them.

    python -m tests.benchmarks record export DIR [CLAIM ...] [--share .02] [--seed N]
    python -m tests.benchmarks record track DIR POINTS.json
    python -m tests.benchmarks record score DIR POINTS.json [--json]

``export`` writes a folder for each recording, with colour images, masks, two kinds of depth images and
``recording.json``, which names them and has the truth. ``track`` writes the points of this library. ``score`` takes
those of any tracker: ``{RECORDING: {"exact": FRAMES, "d455": FRAMES}}``, where FRAMES has for each frame the 14 points
``[x, y, z]`` in order, metres in the camera frame, or null if the frame was refused. A tracker that flags points gives
``{"points": [...], "visible": [true, ...]}`` instead. Recordings and kinds of depth may be left out.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.photos import BLUE
from shape_obs.camera import Intrinsics
from shape_obs.spec import to_plain
from shape_obs.utils.arrays import read_depth, read_image, write_image
from shape_obs.utils.documents import read_json
from shape_obs.utils.files import write_text
from tests.benchmarks.claim import Effort
from tests.benchmarks.record import (
    CLAIMS,
    DEPTHS,
    RECORD,
    Claimed,
    Depths,
    claims_of,
    labels_of,
    new_detector,
    strict_score,
)
from tests.benchmarks.runner import commit_seed, select
from tests.benchmarks.scenes.recorded_ropes import Setting, noise_of, picture, record
from tests.benchmarks.scenes.rope_motion import LENGTH, NODES
from tests.benchmarks.tables import Row, as_markdown, summary

Array = npt.NDArray[np.float64]
COMMANDS: Final = ("export", "track", "score")
_NAME: Final = "recording.json"
_UNITS: Final = (
    "Points are in metres in the camera frame: x right, y down, z forward. Nodes are at equal arc lengths from tip to "
    "tip, on the surface that faces the camera, on the viewing rays of the rope's axis. Depth images are in "
    "millimetres along z, 0 where nothing is measured. Masks have the part of the rope that is in sight."
)
_BY: Final = ("claim", "motion", "hider", "hidden [s]", "hertz", "depth")
_DECIMALS: Final = 6  # of metres and seconds


class Recorded(NamedTuple):
    """A recording in files."""

    folder: Path
    about: Mapping[str, Any]  # ``recording.json``
    setting: Setting
    nodes: Array  # (T, NODES, 3) metres
    visible: npt.NDArray[np.bool_]  # (T, NODES)


def export(folder: Path, names: Sequence[str], effort: Effort) -> list[Path]:
    """Write the recordings of claims, each into a folder of its name, and return the folders.

    Raises:
        FileExistsError: The folder is not empty.
        ValueError: There is no such claim.
    """
    if folder.exists() and any(folder.iterdir()):
        raise FileExistsError(f"{folder}: expected a new or empty folder.")
    claims = select({claim.name: claim for claim in CLAIMS}, list(names))
    return [_written(folder, claim.name, setting) for claim in claims for setting in claim.scenes(effort)]


def _written(folder: Path, claim: str, setting: Setting) -> Path:
    """Write one recording."""
    hidden = f"_{setting.hidden:g}s" if setting.hidden else ""
    place = setting.hider.replace(" ", "_")
    name = f"{claim.partition('.')[2]}_{setting.motion}_{place}{hidden}_{setting.hertz}hz_{setting.seed}"
    recording, noise, path = record(setting), noise_of(setting), folder / name
    rng, frames = np.random.default_rng(setting.seed), list[dict[str, Any]]()
    light = float(rng.uniform(0, 2 * np.pi))
    for each in ("colour", "mask", *(f"depth_{depths}" for depths in DEPTHS)):
        (path / each).mkdir(parents=True)
    for number, frame in enumerate(recording.frames):
        file = f"{number:06}.png"
        write_image(path / "colour" / file, picture(rng, frame, light))
        images = {"mask": frame.mask, "depth_exact": frame.depth, "depth_d455": noise(frame.depth)}
        for each, image in images.items():
            _write_gray(path / each / file, image if each == "mask" else np.rint(1e3 * image).astype(np.uint16))
        frames.append(
            {
                "stamp": round(frame.stamp, _DECIMALS),
                "colour": f"colour/{file}",
                "mask": f"mask/{file}",
                "depth": {depths: f"depth_{depths}/{file}" for depths in DEPTHS},
                "nodes": np.round(frame.nodes, _DECIMALS).tolist(),
                "visible": frame.visible.tolist(),
            }
        )
    about = {
        "units": _UNITS, "claim": claim, **setting._asdict(), "peak": recording.peak, "radius": recording.radius,
        "length": LENGTH, "camera": to_plain(recording.camera), "frames": frames,
    }  # fmt: skip
    write_text(path / _NAME, json.dumps(about) + "\n")
    return path


def _write_gray(path: Path, image: npt.NDArray[Any]) -> None:
    if not cv2.imwrite(str(path), image):
        raise OSError(f"{path}: cannot be written")


def read_recordings(folder: Path) -> dict[str, Recorded]:
    """Read the truth of every recording in a folder, by name.

    Raises:
        FileNotFoundError: There is none.
        ValueError: One is damaged.
    """
    found = {path.parent.name: _read(path) for path in sorted(folder.glob(f"*/{_NAME}"))}
    if not found:
        raise FileNotFoundError(f"{folder}: no recordings; `record export {folder}` writes some.")
    return found


def _read(path: Path) -> Recorded:
    about = read_json(path, "recording")
    try:
        frames, setting = about["frames"], Setting(**{name: about[name] for name in Setting._fields})
        nodes = np.array([frame["nodes"] for frame in frames], np.float64)
        visible = np.array([frame["visible"] for frame in frames], bool)
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: not a recording of `record export`: {error!r}.") from error
    if nodes.shape[1:] != (NODES, 3) or visible.shape != nodes.shape[:2]:
        raise ValueError(f"{path}: expected {NODES} nodes in each frame, got arrays {nodes.shape}, {visible.shape}.")
    return Recorded(path.parent, about, setting, nodes, visible)


def track(recorded: Recorded, depths: Depths) -> list[Any]:
    """Return the points of this library from the colour and depth images of a recording, as ``score`` reads them."""
    about = recorded.about
    camera = Intrinsics.from_dict(about["camera"])
    detector, found = new_detector(camera, recorded.nodes[0], about["hertz"], BLUE), []
    for frame in about["frames"]:
        rgb, depth = read_image(recorded.folder / frame["colour"]), read_depth(recorded.folder / frame["depth"][depths])
        found.append(detector.detect(rgb, depth, camera, stamp=frame["stamp"]))
    claims = claims_of(found)
    return [
        {"points": np.round(points, _DECIMALS).tolist(), "visible": visible.tolist()}
        if np.isfinite(points).all()
        else None
        for points, visible in zip(claims.points, claims.visible, strict=True)
    ]


def read_points(path: Path, recordings: Mapping[str, Recorded]) -> Iterator[tuple[Recorded, Depths, Claimed]]:
    """Yield what a tracker claims of each recording with each kind of depth.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It has something else, or other recordings, frames or points.
    """
    given = read_json(path, "points")
    form = f'{{RECORDING: {{"{DEPTHS[0]}": FRAMES, "{DEPTHS[1]}": FRAMES}}}}'
    if not isinstance(given, dict) or not given or not all(isinstance(each, dict) and each for each in given.values()):
        raise ValueError(f"{path}: expected {form}.")
    for name, kinds in given.items():
        if name not in recordings:
            raise ValueError(f"{path}: no recording {name!r}; there are {', '.join(recordings)}.")
        for depths in kinds:
            if depths not in DEPTHS:
                raise ValueError(f"{path}: {name}: no depth {depths!r}; there are {' and '.join(DEPTHS)}.")
            recorded, frames = recordings[name], kinds[depths]
            if not isinstance(frames, list) or len(frames) != len(recorded.nodes):
                got = len(frames) if isinstance(frames, list) else type(frames).__name__
                raise ValueError(f"{path}: {name}, {depths}: expected {len(recorded.nodes)} frames, got {got}.")
            where = f"{path}: {name}, {depths}"
            claims = [_frame(each, f"{where}, frame {k}") for k, each in enumerate(frames)]
            yield recorded, depths, Claimed(*(np.stack(each) for each in zip(*claims, strict=True)))


def _frame(given: Any, where: str) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return the points of a frame, all NaN for one that was refused, and which of them are called visible."""
    flags = np.ones(NODES, bool)
    if given is None:
        return np.full((NODES, 3), np.nan), flags
    if isinstance(given, dict):
        if set(given) != {"points", "visible"}:
            raise ValueError(f"{where}: expected the names points and visible, got {', '.join(given) or 'none'}.")
        given, called = given["points"], given["visible"]
        if not isinstance(called, list) or len(called) != NODES or not all(isinstance(each, bool) for each in called):
            raise ValueError(f"{where}: expected {NODES} flags, true or false, in visible.")
        flags = np.array(called)
    try:
        points = np.array(given, np.float64)
    except (TypeError, ValueError):
        points = np.zeros(0)
    if points.shape != (NODES, 3):
        got = f"{len(given)} entries" if isinstance(given, list) else type(given).__name__
        raise ValueError(f"{where}: expected {NODES} points [x, y, z], or null for a refused frame, got {got}.")
    if not np.isfinite(points).all():
        raise ValueError(f"{where}: expected finite coordinates in metres, got NaN or infinity: use null if refused.")
    return points, flags


def score(found: Iterable[tuple[Recorded, Depths, Claimed]]) -> list[Row]:
    """Return a row of ``RECORD`` for each kind of recording."""
    rows = []
    for recorded, depths, claimed in found:
        labels = labels_of(recorded.setting, depths, recorded.about["peak"])
        found_score = strict_score(claimed, recorded.nodes, recorded.visible)
        rows.append(Row({**labels, "claim": recorded.about["claim"], **found_score}))
    return summary(rows, _BY, RECORD)


def main(argv: Sequence[str]) -> int:
    """Run ``record export``, ``track`` or ``score`` and return the exit code, 2 for an input that is wrong."""
    prog = "python -m tests.benchmarks record"
    parser = argparse.ArgumentParser(prog=prog, description="Recordings and points in files.")
    commands = parser.add_subparsers(dest="command", required=True)
    for name, about in zip(COMMANDS, ("write recordings", "write our points", "score points"), strict=True):
        command = commands.add_parser(name, help=about, description=about)
        command.add_argument("folder", type=Path, metavar="DIR", help="the folder of the recordings")
        if name == "export":
            command.add_argument("names", nargs="*", metavar="CLAIM", help="such as record.motion (default: all)")
            command.add_argument("--share", type=float, default=0.02, help="share of all recordings (default: 0.02)")
            command.add_argument("--seed", type=int, help="random seed (default: from the commit's hash)")
        else:
            command.add_argument("points", type=Path, metavar="POINTS.json", help="the points of a tracker")
        if name == "score":
            command.add_argument("--json", action="store_true", help="print JSON instead of a table")
    args = parser.parse_args(argv)
    try:
        return _run(args)
    except (OSError, ValueError) as error:
        print(f"{prog} {args.command}: error: {error}", file=sys.stderr)
        return 2


def _run(args: argparse.Namespace) -> int:
    if args.command == "export":
        seed = commit_seed() if args.seed is None else args.seed
        folders = export(args.folder, args.names, Effort(args.share, seed))
        print(f"{len(folders)} recordings of seed {seed} in {args.folder}")
        return 0
    recordings = read_recordings(args.folder)
    if args.command == "track":
        found = {name: {depths: track(each, depths) for depths in DEPTHS} for name, each in recordings.items()}
        write_text(args.points, json.dumps(found) + "\n")
        return 0
    found = list(read_points(args.points, recordings))
    rows = score(found)
    print(json.dumps(to_plain(rows), indent=1) if args.json else as_markdown(rows))
    if not args.json:
        print(f"\n{len(found)} of {len(DEPTHS) * len(recordings)} runs: recordings with exact depth or a D455's noise.")
    return 0
