"""``shape-obs extract --to lerobot``: from the extracted shapes to a LeRobot dataset."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Final

from shape_obs.cli.options import open_named
from shape_obs.utils.errors import UsageError

if TYPE_CHECKING:
    from shape_obs.extraction import Extraction, Task

#: Folder of the extracted shapes inside that of the LeRobot dataset.
PARTS: Final = "extraction"


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
    from shape_obs.extraction.lerobot.videos import need_encoder

    if args.videos:
        need_encoder()
    if args.out.is_dir() and any(args.out.iterdir()) and not (args.out / PARTS).is_dir():
        raise ValueError(f"{args.out}: the folder is not empty, and holds no extraction: choose another --out.")
    if not config.get("features"):
        config["features"] = [{"kind": _feature(tasks)}]


def convert(args: Any, job: Extraction, tasks: Sequence[Task]) -> dict[str, Any]:
    """Write the LeRobot dataset; return its summary for the command's own.

    Raises:
        ValueError: There is no episode, or the episodes do not fit together.
        OSError: A file cannot be read or written.
    """
    from shape_obs.extraction.lerobot import write_lerobot

    names = " and the ".join(shape.name for shape in job.detector().shapes)
    task = f"move the {names}" if args.task is None else args.task
    summary = write_lerobot(job, tasks, args.out, task=task, fps=args.fps, videos=args.videos)
    return {"lerobot": asdict(summary)}


def _feature(tasks: Sequence[Task]) -> str:
    """Return the feature that ``ShapeObservation`` chooses, for the first recording that can be read."""
    from shape_obs.source import SourceError

    for task in tasks:
        with suppress(SourceError), open_named(task.source) as source:  # reported when its episodes are read
            return "points3d" if source.has_depth and source.intrinsics is not None else "points2d_normalized"
    return "points3d"
