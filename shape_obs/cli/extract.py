"""``shape-obs extract``: write the shapes and features of many recorded episodes as Parquet."""

from __future__ import annotations

import json
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import asdict, dataclass
from glob import glob, has_magic
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from shape_obs.cli.options import open_named, warnings_as_lines
from shape_obs.cli.outputs import Overwrite
from shape_obs.cli.parsing import Option, parse, wrong_usage
from shape_obs.utils.documents import parse_yaml
from shape_obs.utils.errors import UsageError
from shape_obs.utils.files import is_leftover, listing

if TYPE_CHECKING:
    from shape_obs.extraction import Extraction, Outcome, Task

#: Folder of the extracted shapes inside that of the LeRobot dataset.
PARTS: Final = "extraction"


@dataclass(frozen=True)
class Arguments:
    """Find the shapes in every recorded episode, and write one Parquet file per episode into a dataset.

    Existing files are kept, so an interrupted run continues where it stopped. The exit code is 0 if every episode is in
    the dataset, and 1 if some failed: these are listed, and written to _failures.json.
    """

    source: Annotated[tuple[str, ...], Option("RECORDING ...", positional=True)]
    """Recorded folders, folders of images, rosbag2 folders, .db3, .bag, .mcap and video files, folders that contain
    these, or patterns."""
    config: Annotated[Path, Option("FILE", "detection", existing="config file")]
    """A YAML config file."""
    out: Annotated[Path, Option("FOLDER", "output", "-o")]
    """The dataset's folder."""
    features: Annotated[tuple[str, ...], Option("FEATURE ...", "detection")] = ()
    """Features, each a name or a YAML mapping; replaces those of the config."""
    frames: Annotated[int | None, Option("N", "source", least=1)] = None
    """Largest number of frames of each episode."""
    extrinsics: Annotated[Path | None, Option("FILE", "source", existing="file of extrinsics")] = None
    """A file with the pose of the camera in the base frame; replaces the recorded poses."""
    jobs: Annotated[int | None, Option("N", "processing", least=1)] = None
    """Number of episodes processed at once; default: 1, or on Ray the number of processors."""
    engine: Annotated[Literal["local", "ray"], Option(group="processing")] = "local"
    """Processes of this machine, or a Ray cluster (needs the extra 'ray')."""
    address: Annotated[str | None, Option("ADDRESS", "processing")] = None
    """Address of the Ray cluster, 'auto' for the one this machine belongs to; default: start one on this machine."""
    to: Annotated[Literal["parquet", "lerobot"], Option(group="output")] = "parquet"
    """'lerobot' also writes a LeRobot v3 dataset for imitation learning, with the Parquet files in its folder
    'extraction'."""
    task: Annotated[str | None, Option("TEXT", "LeRobot")] = None
    """What is done in the episodes, in words; default: that of an earlier run, or 'move the' and the names of the
    shapes."""
    videos: Annotated[bool, Option(group="LeRobot")] = False
    """Encode the camera's images as H.264 (needs the extra 'video')."""
    fps: Annotated[float | None, Option("HZ", "LeRobot", above=0, most=1000)] = None
    """Frames per second; default: that of an earlier run, or the median rate of the stamps, a whole number if it is
    within 1 % of one."""
    overwrite: Overwrite = False
    """Replace a LeRobot dataset that was changed since it was written; recordings and shapes are never replaced."""
    json: Annotated[bool, Option(group="output")] = False
    """Print the summary as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the command and return the exit code."""
    args = parse(Arguments, argv, "shape-obs extract")
    check_lerobot(args)
    if args.address is not None and args.engine != "ray":
        raise UsageError("--address: only for a Ray cluster; give --engine ray too.")
    features = [_feature(text) for text in args.features]
    from tqdm import tqdm

    from shape_obs.config.config_file import load_config
    from shape_obs.extraction import Extraction, all_tasks, extract
    from shape_obs.features import read_features

    config = load_config(args.config)
    if args.features:
        with wrong_usage():
            config["features"] = [feature.to_dict() for feature in read_features(features)]
    tasks = all_tasks(recordings(args.source))
    if args.to == "lerobot":
        prepare(args, config, tasks)
    parts = args.out / PARTS if args.to == "lerobot" else args.out
    job = Extraction(config, parts, open_named, args.extrinsics, args.frames)
    found: list[Outcome] = []
    with warnings_as_lines("shape-obs extract"):
        run = extract(job, tasks, engine=args.engine, jobs=args.jobs, address=args.address)
        with (
            closing(run) as outcomes,
            tqdm(outcomes, total=len(tasks), unit="episode", leave=False, desc="extracting") as bar,
        ):
            for outcome in bar:
                found.append(outcome)
                if outcome.status == "failed":
                    bar.write(f"failed: {outcome.task.source}: {outcome.reason}", file=sys.stderr)
        written = convert(args, job, tasks) if args.to == "lerobot" else {}
        for text in sorted({text for outcome in found for text in outcome.warnings}):
            print(f"shape-obs extract: {text}", file=sys.stderr)
    found.sort(key=lambda outcome: (outcome.task.source, outcome.task.index))
    result = {**_result(job, found), **written}
    print(json.dumps(result) if args.json else summary(result))
    return int(bool(result["failed"]))


def recordings(texts: Sequence[str]) -> list[str]:
    """Return all recordings that paths, folders and patterns refer to, each once.

    Raises:
        ValueError: There is no text, no such path, or no recording in a folder or pattern.
    """
    if not texts:
        raise ValueError("give at least one recording, or a folder of them.")
    found: list[str] = []
    for text in texts:
        if has_magic(text) and not Path(text).exists():
            paths = [path for path in map(Path, sorted(glob(text, recursive=True))) if not is_leftover(path.name)]
        else:
            paths = [Path(text)]
            if not paths[0].exists():
                raise ValueError(f"{text}: no such file or folder; record a camera or an environment first.")
        inside = [str(inner) for path in paths for inner in (_inside(path) if path.is_dir() else [path])]
        if not inside:
            raise ValueError(
                f"{text}: found no recording there: no recorded folder, images, .db3, .bag, .mcap or video file."
            )
        found += inside
    return list(dict.fromkeys(found))


def summary(result: dict[str, Any]) -> str:
    """Return the lines that the command prints."""
    lines = [
        f"episodes        {result['done']} done, {result['kept']} kept, {len(result['failed'])} failed",
        f"frames          {result['frames']}",
        *(f"{name:<15} ok in {ok}, {ok / max(result['frames'], 1):.1%}" for name, ok in result["ok"].items()),
        *(f"failed          {failure['source']}: {failure['reason']}" for failure in result["failed"]),
        f"wrote           {result['files']} files in {result['out']}",
    ]
    if "lerobot" in result:
        made = result["lerobot"]
        lines.append(f"lerobot         {made['episodes']} episodes, {made['frames']} frames at {made['fps']:.6g} Hz")
        lines.append(f"  task           {made['task']}")
        lines += [f"  {name:<32} {' x '.join(map(str, shape))}" for name, shape in made["features"].items()]
    return "\n".join(lines)


def _result(job: Extraction, found: Sequence[Outcome]) -> dict[str, Any]:
    status, ok = Counter(outcome.status for outcome in found), Counter[str]()
    for outcome in found:
        ok.update(outcome.ok)
    failed = [outcome for outcome in found if outcome.status == "failed"]
    return {
        "done": status["done"],
        "kept": status["kept"],
        "frames": sum(outcome.frames for outcome in found),
        "ok": dict(ok),
        "failed": [
            {"source": outcome.task.source, "index": outcome.task.index, "reason": outcome.reason} for outcome in failed
        ],
        "files": len(found) - len(failed),
        "out": str(job.out),
    }


def _inside(folder: Path) -> Iterator[Path]:
    """Yield the recordings in a folder, which may itself be a recording."""
    from shape_obs.recording.format import CAMERA_FILE, FRAMES_FILE
    from shape_obs_envs.sources.opening import MCAP, RECORDINGS, ROSBAG2
    from shape_obs_envs.sources.sequence import PHOTOS
    from shape_obs_envs.sources.video import VIDEOS

    inside = listing(folder)
    names, suffixes = {path.name for path in inside}, {path.suffix.lower() for path in inside if path.is_file()}
    if names & {CAMERA_FILE, FRAMES_FILE, ROSBAG2} or suffixes & set(PHOTOS):
        yield folder
        return
    for path in inside:
        if path.is_dir():
            yield from _inside(path)
        elif path.suffix.lower() in (*RECORDINGS, MCAP, *VIDEOS):
            yield path


def _feature(text: str) -> Any:
    """Read one feature, such as ``fourier`` or ``{kind: fourier, harmonics: 4}``."""
    with wrong_usage():
        return parse_yaml(text, f"--features {text[:60]}")


def check_lerobot(args: Any) -> None:
    """Check how the options go together.

    Raises:
        UsageError: An option of LeRobot datasets is given without ``--to lerobot``.
    """
    if args.to != "lerobot" and (args.task is not None or args.videos or args.fps is not None):
        raise UsageError("--task, --videos and --fps belong to --to lerobot: add it, or leave them out.")


def prepare(args: Any, config: dict[str, Any], tasks: Sequence[Task]) -> None:
    """Check what can be written before hours of work, and choose features if the config has none.

    Args:
        args: The options of the user.
        config: The configuration, which is changed.
        tasks: The episodes.

    Raises:
        ValueError: The folder holds something else.
        ImportError: A required extra is missing.
    """
    from shape_obs.extraction.dataset import DATASET_FILE
    from shape_obs.extraction.lerobot import check_lerobot_folder
    from shape_obs.extraction.lerobot.videos import need_encoder

    if args.videos:
        need_encoder()
    if not args.overwrite:
        check_lerobot_folder(args.out, args.out / PARTS)
    if args.out.is_dir() and listing(args.out) and not (args.out / PARTS / DATASET_FILE).is_file():
        raise ValueError(f"{args.out}: the folder is not empty, and holds no extraction: choose another --out.")
    if not config.get("features"):
        config["features"] = [{"kind": _shape_feature(tasks)}]


def convert(args: Any, job: Extraction, tasks: Sequence[Task]) -> dict[str, Any]:
    """Write the LeRobot dataset; return its summary for the command's own.

    Raises:
        ValueError: There is no episode, or the episodes do not fit together.
        OSError: A file cannot be read or written.
    """
    from shape_obs.extraction.lerobot import write_lerobot

    options = {"task": args.task, "fps": args.fps, "videos": args.videos, "overwrite": args.overwrite}
    summary = write_lerobot(job, tasks, args.out, **options)
    return {"lerobot": asdict(summary)}


def _shape_feature(tasks: Sequence[Task]) -> str:
    """Return the feature that ``ShapeObservation`` chooses, for the first recording that can be read."""
    from shape_obs.source import SourceError

    for task in tasks:
        with suppress(SourceError), open_named(task.source) as source:  # reported when its episodes are read
            return "points3d" if source.has_depth and source.intrinsics is not None else "points2d_normalized"
    return "points3d"
