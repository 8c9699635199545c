"""What commands with ``--source`` share.

What commands before a camera and a robot have in common: their options, and the environment made of them.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2

from shape_obs.config import load_config
from shape_obs.source import RGBDSource
from shape_obs.utils.documents import make_named, parse_yaml

_ERRORS_ALONE: Final = 2  # OpenCV's LOG_LEVEL_ERROR


def open_named(text: str, extrinsics: Path | None = None, settings: Sequence[str] = (), **options: Any) -> RGBDSource:
    """The source that ``--source``, ``--extrinsics`` and ``--set`` name; not connected yet.

    Args:
        text: ``d455[:serial]``, a file, a folder or an environment's id.
        extrinsics: A file that says where the camera stands.
        settings: ``KEY=VALUE``, for arguments of the source's class; values are read as YAML.
        options: Further arguments.

    Raises:
        ValueError: Settings that are none, or that the source does not have.
        SourceError: No such source.
    """
    from shape_obs_envs.sources import open_source

    return open_source(text, extrinsics=extrinsics, **options, **read_settings(settings))


def read_settings(settings: Sequence[str], option: str = "--set") -> dict[str, Any]:
    """``["exposure=0.01", "camera=d455"]`` -> a mapping, values read as YAML.

    Args:
        settings: What was given.
        option: Its name, for messages.

    Raises:
        ValueError: Not ``KEY=VALUE``, or a value that is no YAML.
    """
    values: dict[str, Any] = {}
    for setting in settings:
        name, equals, value = setting.partition("=")
        if not name.isidentifier() or not equals:
            raise ValueError(f"{option}: expected KEY=VALUE, such as exposure=0.01, got {setting!r}.")
        values[name] = parse_yaml(value, f"{option} {setting[:60]}")
    return values


@contextmanager
def warnings_as_lines(prog: str) -> Iterator[None]:
    """Warnings of the library become one line each on stderr; decoders say nothing, since errors say it better."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    opencv: Any = cv2 if hasattr(cv2, "setLogLevel") else cv2.utils.logging  # of OpenCV 4 and 5
    opencv.setLogLevel(_ERRORS_ALONE)

    def show(message: Warning | str, *_: Any) -> None:
        print(f"{prog}: {' '.join(str(message).split())}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = show
        yield


#: Steps per second where nobody says another.
RATE: Final = 30.0


@dataclass(frozen=True)
class CellArguments:
    """Options that name a camera, a robot and what to look for."""

    source: str = "d455"
    """Where images come from: d455, d455:SERIAL, FILE.db3, FILE.bag, a recorded folder, the id of an environment, or
    'robot' for the camera that the robot brings itself."""
    robot: str | None = None
    """The robot, as module:Class."""
    set: tuple[str, ...] = ()
    """KEY=VALUE: further arguments of the source, such as exposure=100."""
    robot_set: tuple[str, ...] = ()
    """KEY=VALUE: arguments of the robot's class, such as address=10.0.0.2."""
    config: Path | None = None
    """A YAML config file, as `shape-obs detect` writes one for a picked pixel; default what suits the robot."""
    extrinsics: Path | None = None
    """Where the camera stands in the base frame, as `shape-obs calibrate base` writes it."""
    size: tuple[int, int] = (640, 480)
    """Width and height of the images in pixels."""
    rate: float | None = None
    """Steps per second; default 30, and of a trained policy what it was trained at."""
    timeout: float = 1.0
    """Seconds without a frame after which the camera counts as failed."""


def make_robot(args: CellArguments) -> Any:
    """The robot that is asked for, not yet connected.

    Raises:
        ValueError: None is, or it cannot be made.
        ImportError: Its module cannot be imported.
    """
    if args.robot is None:
        raise ValueError("--robot module:Class is needed; shape_obs_envs.robots:NullRobot moves nothing.")
    return make_named(args.robot, "--robot", read_settings(args.robot_set, "--robot-set"))


def make_cell(args: CellArguments, robot: Any, **options: Any) -> Any:
    """The environment ``ShapeObs/D455-v0`` in a ``ShapeObservation``.

    Args:
        args: What the user asked for.
        robot: The robot, or None.
        options: Further arguments of the environment.

    Raises:
        ValueError: There is no config and the robot knows none.
    """
    from shape_obs.wrappers import ShapeObservation

    config = read_config(args, robot)
    return ShapeObservation(open_cell(args, robot, **options), **config)


def read_config(args: CellArguments, robot: Any) -> dict[str, Any]:
    """Arguments of ``ShapeObservation`` in the config file that is asked for; none where the robot knows its own.

    Raises:
        ValueError: There is no config and the robot knows none.
    """
    if args.config is None and not getattr(robot, "shape_obs_defaults", None):
        raise ValueError(
            "--config FILE is needed: it says what the object looks like. `shape-obs detect IMAGE --pick u,v` writes "
            "one."
        )
    config = {} if args.config is None else load_config(args.config)
    if config.get("on_invalid") == "nan":  # a detector's way, which files have filled in; no policy reads NaN
        del config["on_invalid"]
    return config


def open_cell(args: CellArguments, robot: Any, **options: Any) -> Any:
    """The environment ``ShapeObs/D455-v0``, which gives images.

    Args:
        args: What the user asked for.
        robot: The robot, or None.
        options: Further arguments of the environment.
    """
    import gymnasium as gym

    width, height = args.size
    source: Any = args.source
    if source != "robot":
        # Only a camera has a choice.
        mode = {"width": width, "height": height} if source.split(":")[0] == "d455" else {}
        source = open_named(source, args.extrinsics, args.set, **mode)
    return gym.make(
        "shape_obs_envs:ShapeObs/D455-v0",
        source=source,
        robot=robot,
        rate=RATE if args.rate is None else args.rate,
        size=list(args.size),
        timeout=args.timeout,
        disable_env_checker=True,
        **options,
    )
