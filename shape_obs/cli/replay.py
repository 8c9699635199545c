"""``shape-obs replay``: run the detector over a recording, and a trained policy on what it finds."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from shape_obs.cli.options import check_source, open_named, read_settings, scene_of, warnings_as_lines
from shape_obs.cli.outputs import Overwrite, check_outputs
from shape_obs.cli.parsing import Option, parse
from shape_obs.cli.rerun_option import (
    TARGET,
    FrameLog,
    check_target,
    open_rerun,
    rerun_file,
    with_rerun_value,
    working_file,
)
from shape_obs.utils.errors import UsageError

if TYPE_CHECKING:
    from shape_obs.detector import ShapeDetector
    from shape_obs.source import RGBDSource


@dataclass(frozen=True)
class Arguments:
    """Run the detector over a recording; the shapes equal those of the live frames bit for bit.

    The exit code is 0 if every frame was processed, even if its shape was not found.
    """

    recording: Annotated[str, Option("RECORDING", positional=True, check=check_source)]
    """A folder, FILE.db3, FILE.bag, FILE.mcap or a video file; or, with --frames, a camera (d455[:serial], webcam:0,
    module:Class) or the id of an environment."""
    config: Annotated[Path | None, Option("FILE", "detection", existing="config file")] = None
    """A YAML config file; needed unless --verify or --policy is given."""
    policy: Annotated[Path | None, Option("FILE", "detection", existing="policy")] = None
    """A trained policy, as shape_obs.save_policy writes it: find the shapes that it reads, and compute its action for
    each frame, without moving anything. --config then only describes how the object looks; default: as in training."""
    goal: Annotated[Path | None, Option("FILE", "detection", existing="goal file")] = None
    """The goal of the policy, as `shape-obs goal` writes it."""
    csv: Annotated[Path | None, Option("FILE", "output")] = None
    """Write the shapes as a CSV table, and FILE.meta.json next to it."""
    npz: Annotated[Path | None, Option("FILE", "output")] = None
    """Write the shapes as NumPy arrays."""
    parquet: Annotated[Path | None, Option("FILE", "output")] = None
    """Write the shapes as a Parquet table (needs the extra 'parquet')."""
    video: Annotated[Path | None, Option("FILE", "output")] = None
    """Write the frames with the shapes drawn over them: .mp4 (H.264 with the extra 'video'), .avi, or .gif,
    which is at most 640 pixels wide and has at most 12.5 pictures per second."""
    rerun: Annotated[str | None, Option(TARGET, "output", check=check_target)] = None
    """Log frames, shapes and features to rerun: to FILE.rrd, or to a running viewer by its address. Without a value,
    open the viewer, or write a file next to the first output if there is no display (needs the extra 'rerun')."""
    overwrite: Overwrite = False
    """Replace existing files."""
    frames: Annotated[int | None, Option("N", "source", least=1)] = None
    """Largest number of frames."""
    extrinsics: Annotated[Path | None, Option("FILE", "source", existing="file of extrinsics")] = None
    """A file with the pose of the camera in the base frame; replaces the recorded pose."""
    set: Annotated[tuple[str, ...], Option("KEY=VALUE ...", "source", check=read_settings)] = ()
    """Arguments of the source."""
    verify: Annotated[bool, Option(group="source")] = False
    """First check every frame against its checksum, and list all damaged frames."""
    json: Annotated[bool, Option(group="output")] = False
    """Print the summary as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the command and return the exit code."""
    args = parse(Arguments, with_rerun_value(argv), "shape-obs replay")
    detects = args.config is not None or args.policy is not None
    if not detects and not args.verify:
        raise UsageError("give --config FILE or --policy FILE to detect with, or --verify to check the recording.")
    if args.goal is not None and args.policy is None:
        raise UsageError("--goal: only for a trained policy; give --policy FILE.")
    unused = [name for name in ("csv", "npz", "parquet", "video", "rerun") if getattr(args, name) is not None]
    if not detects and unused:
        raise UsageError(f"--{unused[0]} needs --config FILE, which finds the shapes that it shows.")
    tables = _tables(args)
    metadata = None if args.csv is None else args.csv.with_name(f"{args.csv.name}.meta.json")
    check_outputs(args, *tables, metadata, args.video, rerun_file(args.rerun, _rerun_base(args, tables)))
    from shape_obs.config.config_file import load_config
    from shape_obs.recording.table import check_table_path

    for path in tables:
        check_table_path(path)
    arguments = {} if args.config is None else load_config(args.config)
    with warnings_as_lines("shape-obs replay"), open_named(args.recording, args.extrinsics, args.set) as source:
        if (source.live or source.kind == "env") and args.frames is None:
            raise UsageError(f"{source.name} never ends: give --frames N.")
        result: dict[str, Any] = {"source": source.name}
        if args.verify:
            result["verified"] = _verify(source, args.frames)
        if detects:
            result |= _replay(args, arguments, source, tables)
    print(json.dumps(result) if args.json else summary(result))
    return 0


def summary(result: dict[str, Any]) -> str:
    """Return the lines that the command prints."""
    lines = [f"source          {result['source']}"]
    if "verified" in result:
        lines.append(f"verified        {result['verified']} frames, none damaged")
    if "frames" in result:
        lines.append(f"frames          {result['frames']}")
    for name, shape in result.get("shapes", {}).items():
        lines.append(f"{name:<15} ok in {shape['ok']}, {shape['valid_fraction']:.1%} of their points valid")
        lines += [f"  {count:>6} x      {reason}" for reason, count in shape["reasons"].items()]
    if "policy" in result:
        lines.append(_differs(**result["policy"]))
    lines += [f"{count:>8} x      {warning}" for warning, count in result.get("warnings", {}).items()]
    if "ms" in result:
        lines.append(f"ms per frame    {result['ms']['median']:.2f} median, {result['ms']['p95']:.2f} 95th percentile")
    lines += [f"wrote           {path}" for path in result.get("files", ())]
    return "\n".join(lines)


def _differs(actions: int, compared: int, mean: float | None, largest: float | None) -> str:
    """Return the line about the actions of the policy."""
    line = f"policy          {actions} actions"
    if compared:
        line += f"; {compared} recorded ones differ by {mean:.2g} of their range, at most {largest:.2g}"
    return line


def _tables(args: Arguments) -> list[Path]:
    """Return the tables to write, after checking their names."""
    tables = []
    for suffix, path in ((".csv", args.csv), (".npz", args.npz), (".parquet", args.parquet)):
        if path is None:
            continue
        if path.suffix != suffix:
            raise UsageError(f"--{suffix[1:]}: expected a file named *{suffix}, got {path}.")
        tables.append(path)
    return tables


def _verify(source: RGBDSource, frames: int | None) -> int:
    """Read all frames and return their number."""
    from tqdm import tqdm

    from shape_obs.recording import Recording
    from shape_obs.recording.format import read_moments
    from shape_obs.source import BadRecording

    recording = getattr(source, "recording", None)
    bar = partial(tqdm, unit="frame", leave=False, desc="checking")
    if not isinstance(recording, Recording):
        count = sum(1 for _ in bar(read_moments(source, frames)))
        source.disconnect()  # the detector starts from the first frame again
        source.connect()
        return count
    damaged = [wrong for wrong in bar(recording.check(), total=len(recording)) if wrong]
    if damaged:
        raise BadRecording(f"{len(damaged)} of {len(recording)} frames are damaged: {' '.join(damaged)}")
    return len(recording)


def _replay(args: Arguments, arguments: dict[str, Any], source: RGBDSource, tables: list[Path]) -> dict[str, Any]:
    import numpy as np
    from tqdm import tqdm

    from shape_obs.recording import OverlayVideo, ShapeLog
    from shape_obs.recording import replay as detect

    policy, found = None, {}
    if args.policy is None:
        detector = make_detector(arguments, source)
        detections = detect(source, detector, args.frames)
    else:
        from shape_obs.policy.frames import play

        policy, env, arguments = _acting(args, arguments, source)
        detector, detections = env.get_wrapper_attr("detector"), play(policy, env)
    log = ShapeLog(detector, arguments, source)
    times, actions = [], []
    with ExitStack() as stack:
        video = None if args.video is None else stack.enter_context(OverlayVideo(args.video))
        stream = None
        if args.rerun is not None:
            base = _rerun_base(args, tables)
            stream = stack.enter_context(open_rerun(args.rerun, base, "shape-obs replay"))
        shown = None if stream is None else FrameLog(stream, detector, arguments)
        length = args.frames or (len(source) if hasattr(source, "__len__") else None)  # pyright: ignore[reportArgumentType]
        for moment, detection, *action in tqdm(detections, total=length, unit="frame", leave=False, desc="replaying"):
            log.add(moment, detection)
            actions += action
            times.append(detection.timings["total"])
            if video is not None:
                video.add(moment, detection)
            if shown is not None:
                shown.add(moment, detection)
    table = log.table()
    if policy is not None:
        acted = np.array(actions, np.float64).reshape(len(table), -1)
        table = replace(table, columns={**table.columns, "policy": acted})
        found["policy"] = _compared(policy, table)
    for path in tables:
        table.save(path)
    files = [str(path) for path in (*tables, args.video, stream and stream.path) if path is not None]
    shapes = {spec.name: _summary_of(table, spec.name) for spec in detector.shapes}
    ms = {"median": round(float(np.median(times)), 3), "p95": round(float(np.percentile(times, 95)), 3)}
    hashes = {name: log.metadata[name] for name in ("schema_hash", "config_hash")}
    said = _counted(table["warning"])
    return {"frames": len(table), "shapes": shapes, **found, "warnings": said, "ms": ms, "files": files, **hashes}


def _acting(args: Arguments, config: dict[str, Any], source: RGBDSource) -> tuple[Any, Any, dict[str, Any]]:
    """Return a policy, the environment of frames in which it acts, and the configuration of its detector."""
    from shape_obs.policy import load_policy
    from shape_obs.policy.contract import describe
    from shape_obs.policy.frames import RecordedFrames
    from shape_obs.wrappers import Target

    assert args.policy is not None
    policy = load_policy(args.policy)
    if policy.spec.needs_goal and args.goal is None and not policy.spec.has_goal:
        raise UsageError("the policy needs a goal: give --goal FILE, as `shape-obs goal` writes it.")
    goal = None if args.goal is None else Target.load(str(args.goal))
    scene = _lenient({**scene_of(policy.spec.config or {}), **scene_of(config)}, "hold")
    env = policy.wrap(RecordedFrames(source, policy.spec, args.frames), goal, scene)
    policy.check_env(env, same_rate=False)
    return policy, env, dict(describe(env).config or {})


def _compared(policy: Any, table: Any) -> dict[str, Any]:
    """Compare the actions of a policy with those that were recorded."""
    from shape_obs.policy.policy import action_difference

    recorded = table.columns.get("action", table["policy"][:0])
    pairs = zip(table["policy"], recorded, strict=False)
    differences = [action_difference(policy.spec.action, one, other) for one, other in pairs if other.size == one.size]
    known = [value for value in differences if value == value]  # NaN where no action was recorded
    mean, largest = (round(sum(known) / len(known), 6), round(max(known), 6)) if known else (None, None)
    return {"actions": len(table), "compared": len(known), "mean": mean, "largest": largest}


def make_detector(arguments: dict[str, Any], source: RGBDSource) -> ShapeDetector:
    """Make the detector of a config that goes on after a lost shape, and check that the source has what it needs.

    Raises:
        ValueError: The config needs depth or intrinsics, which the source lacks.
    """
    from shape_obs.config.config_file import detector_arguments
    from shape_obs.detector import ShapeDetector
    from shape_obs.recording.replay import check_depth

    detector = ShapeDetector(**_lenient(detector_arguments(arguments)))
    check_depth(source, detector, arguments)
    return detector


def _rerun_base(args: Arguments, tables: list[Path]) -> Path:
    """Return the file of ``--rerun`` without its suffix: next to the first output, else in the working folder."""
    outputs = [path.with_suffix("") for path in (*tables, args.video) if path is not None]
    return (*outputs, working_file(args.recording))[0]


def _lenient(arguments: dict[str, Any], instead: str = "nan") -> dict[str, Any]:
    """Replace ``on_missing="raise"``: a replay continues after a lost shape, whose row is not ok."""
    return {**arguments, "on_missing": instead} if arguments.get("on_missing") == "raise" else arguments


def _summary_of(table: Any, name: str) -> dict[str, Any]:
    ok, valid = table[f"{name}/ok"], table[f"{name}/valid"]
    return {
        "ok": int(ok.sum()),
        "valid_fraction": round(float(valid[ok].mean()), 4) if ok.any() else 0.0,
        "reasons": _counted(table[f"{name}/reason"]),
    }


def _counted(texts: Any) -> dict[str, int]:
    """Return how often each text that is not empty occurs in a column."""
    return dict(Counter(text for text in texts.tolist() if text))
