"""Define the files of a recorded folder, and read moments from sources.

``camera.json`` is written first, then images, and a line of ``frames.jsonl`` only after the images that it names, so
that all lines of an interrupted recording are complete. The last line marks the end of a recording. Images are lossless
files with two checksums, one of the file and one of the array.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple, TypeVar

from shape_obs.camera import CameraModel, Intrinsics
from shape_obs.frame import Frame
from shape_obs.robot import ActionSpec
from shape_obs.source import EndOfSource, RGBDSource
from shape_obs.spec import Spec, SpecError
from shape_obs.tracking.clock import Clock

T = TypeVar("T", bound=Spec)

FORMAT: Final = "shape_obs recording"
VERSION: Final = 1
CAMERA_FILE: Final = "camera.json"
FRAMES_FILE: Final = "frames.jsonl"
END: Final = "end"


@dataclass(frozen=True)
class Transition(Spec):
    """The step that led to a frame: an action, and what ``env.step`` returned with the frame.

    Args:
        step: Number of steps since the episode began; 0 for its first frame, to which no step led.
        action: ``(A,)`` action, named by ``RobotInfo.action``; None if the robot was made to stand still instead, and
            for the first frame.
        reward: Reward of the step; None for the first frame.
        terminated: Whether the step ended the episode, such as by reaching the goal.
        truncated: Whether the episode was cut off after the step, such as by a time limit.

    Raises:
        SpecError: A value of the wrong type or out of range.
    """

    step: int
    action: tuple[float, ...] | None = None
    reward: float | None = None
    terminated: bool = False
    truncated: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.step < 2**63:
            raise SpecError(f"transition.step: expected 0 or more, got {self.step}.")


@dataclass(frozen=True)
class RobotInfo(Spec):
    """The meaning of the actions and states of a recording.

    Args:
        name: Name of the robot, or id of the environment.
        action: Names of the values of an action; empty if there are no actions.
        state: Names of the values of a state; empty if the state is unknown.
        action_spec: Units, scale and frame of the actions, if known.
    """

    name: str
    action: tuple[str, ...] = ()
    state: tuple[str, ...] = ()
    action_spec: ActionSpec | None = None


def plain(values: Iterable[Any]) -> tuple[float, ...]:
    """Return numbers as Python floats, which a line of ``frames.jsonl`` restores exactly."""
    return tuple(float(value) for value in values)


@dataclass(frozen=True)
class ImageEntry(Spec):
    """An image file of a frame.

    Args:
        file: Path in the recording, such as ``"rgb/000000.png"``.
        crc32: Checksum of the array's bytes.
        file_crc32: Checksum of the file's bytes.
    """

    file: str
    crc32: int
    file_crc32: int


@dataclass(frozen=True)
class FrameLine(Spec):
    """A line of ``frames.jsonl``, which describes a frame.

    Args:
        number: Frame number of the source; None if it has none.
        stamp: Seconds of the source's clock.
        received: Seconds of the recording machine's monotonic clock.
        episode: Number of the episode.
        anchors: Points at which the object was held, by name: (x, y, z) in metres, or (u, v) in pixels.
        camera: Camera of the frame, if it differs from that in ``camera.json``.
        transition: The step of the environment or robot that led to the frame; None if the source takes no steps.
        state: State of the robot when the frame was used, named by ``robot.state`` in ``camera.json``; None if unknown.
        rgb: Colour image.
        depth: Depth image.

    Raises:
        SpecError: A value of the wrong type.
    """

    number: int | None
    stamp: float | None
    received: float | None
    episode: int
    anchors: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    camera: Mapping[str, Any] | None = None
    transition: Transition | None = None
    state: tuple[float, ...] | None = None
    rgb: ImageEntry | None = None
    depth: ImageEntry | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("number", "episode"):
            if not -(2**63) <= (getattr(self, name) or 0) < 2**63:
                raise SpecError(f"{name}: expected an integer of 64 bits.")
        for name, point in self.anchors.items():
            if len(point) not in (2, 3):
                raise SpecError(f"anchors.{name}: expected (x, y, z) or (u, v), got {point}.")


@dataclass(frozen=True)
class CameraFile(Spec):
    """The content of ``camera.json``, besides the camera model.

    Args:
        source: ``kind`` and ``name`` of the recorded source.
        serial: Serial number of the camera, if known.
        depth: Whether frames carry depth.
        robot: Names of the values of actions and states; None if none are recorded.

    Raises:
        SpecError: A value of the wrong type.
    """

    source: Mapping[str, str]
    serial: str | None
    depth: bool
    robot: RobotInfo | None = None


def read_known(kind: type[T], content: Mapping[str, Any]) -> T:
    """Build a spec from a mapping, ignoring unknown fields, which later versions may have added.

    Raises:
        SpecError: A field is missing or of the wrong type.
    """
    names = {each.name for each in dataclasses.fields(kind)}  # type: ignore[arg-type]
    return kind.from_dict({name: value for name, value in content.items() if name in names})


def camera_to_dict(camera: CameraModel | None) -> dict[str, Any]:
    """Return a camera as JSON values, from which ``camera_from_dict`` restores every number exactly."""
    pose = None if camera is None else camera.transform_camera_to_base
    return {
        "intrinsics": None if camera is None else camera.intrinsics.to_dict(),
        "transform_camera_to_base": None if pose is None else pose.tolist(),
    }


def camera_from_dict(content: Mapping[str, Any]) -> CameraModel | None:
    """Restore a camera from the values of ``camera_to_dict``.

    Raises:
        KeyError: A part is missing.
        TypeError: ``content`` is not a mapping.
        ValueError: A part is not a camera.
    """
    intrinsics, pose = content["intrinsics"], content["transform_camera_to_base"]
    if intrinsics is None:
        return None
    return CameraModel(Intrinsics.from_dict(intrinsics), pose)


class Moment(NamedTuple):
    """A frame, and what else a source publishes of the same instant.

    Attributes:
        frame: Frame of the camera.
        anchors: Points at which the object was held, by name: (x, y, z) in metres in the base frame, or pixel (u, v).
            Sources publish them in the attribute ``anchors``.
        episode: Number of the episode; between two episodes the scene may jump. Sources publish it in the attribute
            ``episode``.
        transition: The step that led to the frame; None if the source takes no steps. Sources publish it in the
            attribute ``transition``.
        state: ``(S,)`` state of the robot, in the units of its ``action_spec``; None if unknown. Sources publish it in
            the attribute ``state``, and the names in ``robot_info``.
    """

    frame: Frame
    anchors: Mapping[str, Sequence[float]] = {}
    episode: int = 0
    transition: Transition | None = None
    state: tuple[float, ...] | None = None


def read_moment(source: RGBDSource, timeout: float) -> Moment:
    """Read the next frame of a source and what the source publishes with it; raise as ``source.read`` does.

    Raises:
        TypeError: The source, of a user's own class, returned something else.
    """
    frame = source.read(timeout)
    if not isinstance(frame, Frame):
        raise TypeError(f"{source.name}: read() returned a {type(frame).__name__}, expected a shape_obs.Frame.")
    return Moment(
        frame,
        dict(getattr(source, "anchors", {})),
        getattr(source, "episode", 0),
        getattr(source, "transition", None),
        getattr(source, "state", None),
    )


def read_moments(
    source: RGBDSource, frames: int | None = None, seconds: float | None = None, patience: float = 20.0
) -> Iterator[Moment]:
    """Yield the moments of a source until it ends.

    Args:
        source: The source; it is connected if necessary.
        frames: Largest number of frames.
        seconds: Largest duration by the stamps, as ``Clock`` measures it; the end is not included.
        patience: Seconds to wait for a frame; longer than a camera needs to recover after it stopped.

    Raises:
        ValueError: A limit is out of range, or ``seconds`` is given for a source without stamps.
        SourceError: ``source.connect`` or ``source.read`` fails.
    """
    if frames is not None and frames < 1:
        raise ValueError(f"frames: expected 1 or more, got {frames}.")
    if seconds is not None and not seconds > 0:
        raise ValueError(f"seconds: expected more than 0, got {seconds}.")
    source.connect()
    clock, count = Clock(), 0
    while frames is None or count < frames:
        try:
            moment = read_moment(source, patience)
        except EndOfSource:
            return
        stamp = moment.frame.stamp
        if seconds is not None:
            if stamp is None:
                raise ValueError(f"{source.name}: its frames have no stamps: give frames in place of seconds.")
            clock.tick(stamp)
            # Half a millisecond of tolerance, so that rounding errors do not add a frame.
            if clock.now > seconds - 5e-4:
                return
        yield moment
        count += 1
