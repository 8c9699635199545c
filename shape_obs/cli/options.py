"""Options that several commands share: sources of frames, ``KEY=VALUE`` settings, the camera and the robot."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from shape_obs.cli.parsing import Option, wrong_usage
from shape_obs.utils.documents import make_named, parse_yaml
from shape_obs.utils.errors import UsageError

if TYPE_CHECKING:
    from shape_obs.source import RGBDSource

#: Steps per second of a real-robot environment unless the user gives a rate.
RATE: Final = 30.0
#: ``shape_obs.markers.DICTIONARY``, repeated here because ``--help`` must not import OpenCV.
DICTIONARY: Final = "4x4_50"
NEEDS_CONFIG: Final = (
    "--config FILE is needed: it describes how the object looks. `shape-obs detect IMAGE --pick u,v` writes one."
)

_LOG_LEVEL_ERROR: Final = 2  # of OpenCV


def open_named(
    text: str,
    extrinsics: Path | None = None,
    settings: Sequence[str] = (),
    **options: Any,
) -> RGBDSource:
    """Make the source that ``--source``, ``--extrinsics`` and ``--set`` describe; it is not connected yet.

    Args:
        text: A camera, a file, a folder, ``module:Class`` or the id of an environment; see ``open_source``.
        extrinsics: A file with the pose of the camera in the base frame.
        settings: ``KEY=VALUE`` arguments of the source's class; values are read as YAML.
        options: Further arguments of the source's class.

    Raises:
        UsageError: A setting is not ``KEY=VALUE``, or the source does not have it.
        SourceError: There is no such source.
    """
    options |= read_settings(settings)
    from shape_obs_envs.sources import open_source

    with wrong_usage():
        return open_source(text, extrinsics=extrinsics, **options)


def read_settings(settings: Sequence[str], option: str = "--set") -> dict[str, Any]:
    """Read ``["exposure=0.01", "camera=d455"]`` as a mapping whose values are YAML.

    Args:
        settings: The texts that the user gave.
        option: The name of the option, for error messages.

    Raises:
        UsageError: A text is not ``KEY=VALUE``, is given twice, or its value is empty or not YAML.
    """
    values: dict[str, Any] = {}
    for setting in settings:
        name, equals, value = setting.partition("=")
        if not name.isidentifier() or not equals:
            raise UsageError(f"{option}: expected KEY=VALUE, such as exposure=0.01, got {setting!r}.")
        if name in values:
            raise UsageError(f"{option}: {name} is given twice, as {values[name]!r} and {value!r}.")
        with wrong_usage():
            values[name] = parse_yaml(value, f"{option} {setting[:60]}")
        if values[name] is None and value.strip().lower() not in ("null", "~"):
            raise UsageError(f"{option} {setting[:60]}: expected a value; write {name}=null for none.")
        if isinstance(values[name], str) and value.strip()[:1] not in "'\"|>!&" and values[name] != value.strip():
            raise UsageError(f"{option} {setting[:60]}: YAML reads {values[name]!r}; put the text in quotes.")
    return values


def check_source(text: str, option: str = "--source") -> None:
    """Report a file that does not exist before the libraries are imported that would read it.

    Raises:
        FileNotFoundError: ``text`` is the name of a file, and there is none.
    """
    if ":" not in text and Path(text).suffix and not Path(text).exists():
        raise FileNotFoundError(f"{text}: no such file.")


def check_name(text: str, option: str) -> None:
    """Check that ``text`` has the form ``module:Class``, before the module is imported.

    Raises:
        UsageError: It has another form.
    """
    module, _, name = text.partition(":")
    if not module or not name:
        raise UsageError(f"{option}: expected module:Class, such as my_lab.arm:Arm, got {text!r}.")


@contextmanager
def warnings_as_lines(prog: str) -> Iterator[None]:
    """Print each warning of the library once, as one line on stderr, and silence the image and video decoders.

    Decoder messages repeat what the library's own errors explain better.
    """
    import cv2

    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    opencv: Any = cv2 if hasattr(cv2, "setLogLevel") else cv2.utils.logging  # OpenCV 5, OpenCV 4
    opencv.setLogLevel(_LOG_LEVEL_ERROR)

    shown = set[str]()

    def show(message: Warning | str, *_: Any) -> None:
        text = " ".join(str(message).split())
        if text not in shown:
            print(f"{prog}: {text}", file=sys.stderr)
        shown.add(text)

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.simplefilter("ignore", DeprecationWarning)  # some are UserWarnings too, and none is the user's to mend
        warnings.showwarning = show
        yield


@dataclass(frozen=True)
class RobotArguments:
    """Options that describe a camera, a robot and the object to look for."""

    source: Annotated[str, Option("SOURCE", "source", check=check_source)] = "d455"
    """Source of the images: a camera (d455[:serial], d435, webcam:0, module:Class), a recording (FILE.db3, FILE.mcap, a
    folder, ...), the id of an environment, or 'robot' for the robot's own camera."""
    robot: Annotated[str | None, Option("MODULE:CLASS", "robot", check=check_name)] = None
    """The robot's class; shape_obs_envs.robots:SimulatedRobot needs no hardware, NullRobot moves nothing."""
    set: Annotated[tuple[str, ...], Option("KEY=VALUE ...", "source", check=read_settings)] = ()
    """Further arguments of the source, such as exposure=100."""
    robot_set: Annotated[tuple[str, ...], Option("KEY=VALUE ...", "robot", check=read_settings)] = ()
    """Arguments of the robot's class, such as address=10.0.0.2."""
    config: Annotated[Path | None, Option("FILE", "detection", existing="config file")] = None
    """A YAML config file, as `shape-obs detect` writes it for a picked pixel; default: the robot's own config."""
    extrinsics: Annotated[Path | None, Option("FILE", "source", existing="file of extrinsics")] = None
    """The pose of the camera in the base frame, as `shape-obs calibrate base` writes it."""
    size: Annotated[tuple[int, int], Option("WIDTH HEIGHT", "source", least=1)] = (640, 480)
    """Width and height of the images in pixels."""
    rate: Annotated[float | None, Option("HZ", "robot", above=0, most=1000)] = None
    """Steps per second; default 30, or the rate at which a trained policy was trained."""
    timeout: Annotated[float, Option("SECONDS", "source", above=0)] = 1.0
    """Seconds without a frame after which the camera counts as failed."""


def make_robot(args: RobotArguments) -> Any:
    """Make the robot that ``--robot`` names; it is not connected yet.

    Raises:
        UsageError: No robot was given, or it cannot be made.
        ImportError: Its module cannot be imported.
    """
    if args.robot is None:
        raise UsageError("--robot module:Class is needed; shape_obs_envs.robots:NullRobot moves nothing.")
    settings = read_settings(args.robot_set, "--robot-set")
    with wrong_usage():
        return make_named(args.robot, "--robot", settings)


def make_env(args: RobotArguments, robot: Any, **options: Any) -> Any:
    """Make the environment ``ShapeObs/D455-v0`` wrapped in ``ShapeObservation``.

    Args:
        args: The options of the user.
        robot: The robot, or None.
        options: Further arguments of the environment.

    Raises:
        ValueError: There is no config, and the robot has none of its own.
    """
    from shape_obs.wrappers import ShapeObservation

    config = read_config(args, robot)
    return ShapeObservation(make_bare_env(args, robot, **options), **config)


def make_bare_env(args: RobotArguments, robot: Any, **options: Any) -> Any:
    """Make the environment ``ShapeObs/D455-v0``, whose observations are images.

    Args:
        args: The options of the user.
        robot: The robot, or None.
        options: Further arguments of the environment.
    """
    import gymnasium as gym

    width, height = args.size
    source: Any = args.source
    if source != "robot":
        from shape_obs_envs.sources.opening import takes_size

        mode = {"width": width, "height": height} if takes_size(source) else {}
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


def read_config(args: RobotArguments, robot: Any) -> dict[str, Any]:
    """Return the arguments of ``ShapeObservation`` in ``--config``; empty if the robot brings its own.

    Raises:
        UsageError: There is no config, and the robot has none of its own.
    """
    from shape_obs.config.config_file import load_config

    if args.config is None and not getattr(robot, "shape_obs_defaults", None):
        raise UsageError(NEEDS_CONFIG)
    config = {} if args.config is None else load_config(args.config)
    if config.get("on_invalid") == "nan":  # the detector's default, which saved files contain; no policy reads NaN
        del config["on_invalid"]
    return config


def scene_of(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries of a config that differ between the training of a policy and a site.

    The duration of a step is that of the loop.
    """
    from shape_obs.config.config_file import SECTIONS

    names = ("shapes", *SECTIONS["scene"], *SECTIONS["runtime"])
    return {name: config[name] for name in names if name in config and name != "dt"}
