"""The environment of a real robot: a source observes, a robot acts, steps run at a fixed rate."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraModel
from shape_obs.frame import Frame
from shape_obs.robot import Anchors, Robot, RobotError, check_robot, robot_anchors
from shape_obs.servo.action_limiter import Box, Guard, Guarded
from shape_obs.source import NotConnected, RGBDSource, SourceError
from shape_obs.utils.documents import make_named
from shape_obs.utils.errors import ending
from shape_obs.utils.timing import CLOCK, Clock, Rate
from shape_obs_envs.arguments import count, one_of, positive
from shape_obs_envs.real.frame_reader import FrameReader, delivers_depth, open_frame_source
from shape_obs_envs.real.interlock import Interlock

Observation = dict[str, npt.NDArray[Any]]
#: Margin of the observation space around the workspace, as a fraction of its size: a robot that was guided by hand may
#: be outside.
_MARGIN: Final = 0.25


class D455Env(gym.Env[Any, Any]):
    """An environment with a camera and a robot.

    ``reset`` connects, sends the robot to its start and waits for a frame. ``step`` sends the action, waits for its
    deadline and returns the newest frame that arrived after the action was sent, never an older one. Rewards are 0;
    use ``ShapeGoal`` for rewards.

    A motion ends ``max_age`` seconds after the exposure of the last observation's image, unless a new one replaces it.
    An action whose observation is older is not sent: the robot stands still, and ``info["withheld"]`` contains the
    reason.

    If the camera fails, the episode ends with ``truncated``, ``info["camera_error"]`` contains the reason, the images
    are black, the robot has been stopped, and the next ``reset`` reconnects. Likewise ``info["robot_error"]``.

    Observation: ``rgb`` ``(H, W, 3)`` uint8; if the source has depth, ``depth`` ``(H, W)`` uint16 in millimetres,
    aligned, 0 where unknown, and ``rgb`` is that of a pinhole camera; with a robot also ``robot`` ``(A,)`` float32, its
    commanded position in the units of its ``action_spec``.
    Action: ``(A,)`` in -1 ... 1, scaled and limited by a ``Guard``; None stands still. Without a robot there is a
    single action, to observe.

    ``info``: ``stamp`` (seconds of the camera's clock), ``frame`` (its number), ``received`` and ``exposed`` (seconds
    of ``time.monotonic``), ``lag`` (delay in seconds against the fastest frames), ``overrun`` (the deadline had
    passed), and the effects of the guard: ``guard/clipped``, ``guard/capped``, ``guard/boxed``.

    Args:
        source: A source, or a string for ``shape_obs_envs.sources.open_source``: "d455", "webcam:0", a recording, a
            video, "module:Class", an environment's id, ...; "robot" for the robot's own camera.
        robot: A robot, or "module:Class"; None to only observe.
        robot_arguments: Keyword arguments of that class.
        rate: Steps per second.
        size: [width, height] of the images in pixels.
        extrinsics: File with the camera's pose in the base frame; see ``shape-obs calibrate base``.
        depth: Whether to observe depth; True raises an error if the source has none, None observes it if it has.
        timeout: Longest wait for a frame in seconds; after that the camera counts as failed.
        settle: Observe when the motion is over, as a simulator does: an action takes 1 / rate seconds after it was
            sent, and the frame must be ``settle`` seconds later, which compensates for its transport. A step then takes
            as long as it takes. None observes at the deadline, during the motion or not.
        max_age: Longest time in seconds that a motion may last after the exposure of the image it is based on.
        max_step: Largest motion of each coordinate in a step, shape ``(A,)``, in the robot's units; default one action
            of 1.
        workspace: [low, high], each ``(A,)``: a smaller box than the robot's own.
        render_mode: None or "rgb_array", the last image.
        clock: Time, and the ways to wait for it; replaced in tests.

    Raises:
        ValueError: An argument is out of its range, or the source cannot be opened with the arguments, or has no depth.
        SourceError: A recording, whose depth is unknown until it is read, cannot be read.
        TypeError: The robot does not implement the protocol ``shape_obs.robot.Robot``.
        ImportError: The robot's module cannot be imported, or the extra ``realsense`` is not installed.

    Attributes:
        robot: The robot, or None.
        settle: The argument.
        clock: The argument.
        max_age: The argument; may be changed between steps.
        interlock: Sends motions to the robot and stops it, from any thread; None without a robot.
        source: The source.
        frame: The frame of the last observation; None before the first one and after a camera failure.
        guarded: The last action after the guard; None if there was none.
        withheld: Why the last action was not sent; empty if it was.
        sent_at: ``time.monotonic()`` after the last action was sent, in seconds.
        on_sent: Called in each step after the action was sent and before the wait for the next frame.
        seen_at: ``time.monotonic()`` when the last frame was available, in seconds.
        slack: Time in seconds that the last step waited for its deadline; negative if it was late.
    """

    robot: Robot | None
    settle: float | None
    clock: Clock
    max_age: float
    interlock: Interlock | None
    source: RGBDSource
    frame: Frame | None
    guarded: Guarded | None
    withheld: str
    sent_at: float
    on_sent: Callable[[], object]
    seen_at: float
    slack: float
    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 30}  # noqa: RUF012

    def __init__(
        self,
        source: RGBDSource | str = "d455",
        robot: Robot | str | None = None,
        *,
        robot_arguments: Mapping[str, Any] | None = None,
        rate: float = 30.0,
        size: Sequence[int] = (640, 480),
        extrinsics: str | None = None,
        depth: bool | None = None,
        timeout: float = 1.0,
        settle: float | None = None,
        max_age: float = 0.2,
        max_step: Sequence[float] | None = None,
        workspace: Box | None = None,
        render_mode: str | None = None,
        clock: Clock = CLOCK,
    ) -> None:
        self.render_mode = one_of("render_mode", render_mode, (None, "rgb_array"))
        self.clock, self.rate = clock, Rate(positive("rate", rate, "30", "steps per second"), clock)
        self.metadata = {**type(self).metadata, "render_fps": rate}
        if settle is not None and not (isinstance(settle, (int, float)) and 0 <= settle < 10):
            raise ValueError(f"settle: expected seconds from 0 to below 10, or None, got {settle!r}.")
        self.settle, self.max_age = settle, positive("max_age", max_age, "0.2", "seconds")
        if np.shape(size) != (2,):
            raise ValueError(f"size: expected [width, height] in pixels, got {size!r}.")
        width, height = (count("size", side, 16, 4096) for side in size)
        self.robot = make_named(robot, "robot", robot_arguments) if isinstance(robot, str) else robot
        self.source = open_frame_source(source, self.robot, (width, height), extrinsics)
        patience, has_depth = positive("timeout", timeout, "1.0", "seconds"), delivers_depth(self.source, depth)
        self._reader = FrameReader(self.source, (width, height), patience, has_depth, now=clock.now)
        observed: dict[str, gym.spaces.Space[Any]] = {"rgb": gym.spaces.Box(0, 255, (height, width, 3), np.uint8)}
        if has_depth:
            observed["depth"] = gym.spaces.Box(0, 65535, (height, width), np.uint16)
        self.action_space = gym.spaces.Discrete(1)
        self.guard: Guard | None = None
        self._reach: gym.spaces.Box | None = None
        self.interlock = None
        if self.robot is not None:
            check_robot(self.robot)
            self.interlock, spec = Interlock(self.robot, clock), self.robot.action_spec
            self.guard = Guard(spec, max_step, workspace, self.rate.dt)
            margin = _MARGIN * (np.asarray(spec.high) - spec.low)
            low, high = np.asarray(spec.low) - margin, np.asarray(spec.high) + margin
            self._reach = gym.spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)
            observed["robot"] = self._reach
            self.action_space = gym.spaces.Box(-1.0, 1.0, (len(spec),), np.float32)
        self.observation_space = gym.spaces.Dict(observed)
        self.sent_at = self.seen_at = clock.now()
        self.slack, self.withheld = 0.0, ""
        self.on_sent = lambda: None
        self.guarded = self.frame = None
        self._exposed = -math.inf

    # ---- gymnasium

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Connect if necessary, send the robot to its start, and wait for a frame.

        Raises:
            SourceError: The camera is not available; the subclass and the message give the reason.
            RobotError: The robot failed.
            ValueError: The images of the source do not have the environment's size.
        """
        super().reset(seed=seed)
        self.guarded, self.withheld = None, ""
        try:
            self.connect()
            if self.interlock is not None:
                self.interlock.reset()
            self._accept(self._reader.frame_after(self.clock.now()))
        except BaseException:  # raised again, after those who were connected are stopped
            with ending(self._abandon):
                raise
        self.rate.start()
        return self._observe(), self._info(overrun=False)

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Send the action, wait for the deadline, and observe; None stands still.

        Raises:
            ValueError: The action has a wrong shape, or values that are not finite. The robot has been stopped.
            NotConnected: ``reset`` is required first: at the start, and after an episode that ended with an error.
        """
        errors: dict[str, str] = {}
        try:
            self._send(action)
            self.sent_at = self.clock.now()
            self.on_sent()
            self._accept(self._wait_for_frame())
        except NotConnected:
            raise
        except (SourceError, RobotError) as error:
            errors["camera_error" if isinstance(error, SourceError) else "robot_error"] = str(error)
        except ValueError:
            with ending(self._abandon):
                raise
        if errors:
            self.frame = None
            try:
                self._abandon()
            except (SourceError, RobotError) as error:
                errors.setdefault("robot_error", str(error))
        info = self._info(overrun=self.slack < 0)
        return self._observe(), 0.0, False, bool(errors), {**info, **errors}

    def render(self) -> Any:
        """Return the last image ``(H, W, 3)`` uint8 RGB, with "rgb_array"; None before the first."""
        return None if self.frame is None or self.frame.rgb is None else self.frame.rgb.copy()

    def close(self) -> None:
        """Stop the robot and disconnect without moving it. A later ``reset`` connects again."""
        last = [] if self.interlock is None else [self.interlock.close]
        with ending(*last):
            self._abandon()

    # ---- published

    def connect(self) -> None:
        """Connect robot and camera, unless they are connected, and allow motions; nothing moves.

        Raises:
            SourceError: The camera is not available; the subclass and the message give the reason.
            RobotError: The robot is not available.
        """
        if self.interlock is not None:
            self.interlock.connect()
        self._reader.connect()

    @property
    def dt(self) -> float:
        """Duration of a step in seconds."""
        return self.rate.dt

    @property
    def camera_model(self) -> CameraModel | None:
        """Intrinsics and, if extrinsics are known, pose; None if unknown.

        Before the first reset: nominal intrinsics of a D455 if the source has depth.
        """
        return self._reader.camera

    @property
    def anchors(self) -> Anchors:
        """Where the robot holds the object: name -> (x, y, z) in metres, base frame."""
        return {} if self.robot is None else robot_anchors(self.robot)

    @property
    def shape_obs_defaults(self) -> Mapping[str, Any]:
        """Suitable arguments of ``ShapeObservation`` for the object, if the robot provides them."""
        return getattr(self.robot, "shape_obs_defaults", {})

    # ---- internal

    def _send(self, action: Any) -> None:
        self.guarded, self.withheld = None, ""
        if self.guard is None or self.interlock is None:
            return
        if action is None:
            self.interlock.stop()
            return
        self.guarded = self.guard.motion(action, self.interlock.state())
        self.withheld = self.interlock.send(self.guarded.motion, self._exposed + self.max_age)

    def _wait_for_frame(self) -> Frame:
        """Wait for the deadline and for a frame."""
        if self.settle is None:
            self.slack = self.rate.wait()
            return self._reader.frame_after(self.sent_at)
        # No step is late here: the deadline counts from when the motion began.
        self.rate.deadline = self.sent_at + self.rate.dt
        self.slack = self.rate.wait()
        return self._reader.frame_of(self.sent_at + self.rate.dt + self.settle)

    def _accept(self, frame: Frame) -> None:
        self.frame, self.seen_at = frame, self.clock.now()
        self._exposed = self._reader.exposed(frame, self.seen_at)

    def _observe(self) -> Observation:
        images = self._reader.images(self.frame)
        if self.interlock is not None and self._reach is not None:
            position = np.asarray(self.interlock.state(), np.float32)
            images["robot"] = np.clip(position, self._reach.low, self._reach.high)
        return images

    def _info(self, *, overrun: bool) -> dict[str, Any]:
        info = {"overrun": overrun, **self._reader.info(self.frame, self._exposed)}
        if self.guarded is not None:
            _, clipped, capped, boxed = self.guarded
            info |= {"guard/clipped": clipped, "guard/capped": capped, "guard/boxed": boxed}
        if self.withheld:
            info["withheld"] = self.withheld
        return info

    def _abandon(self) -> None:
        """Stop the robot and disconnect the camera, so that the next reset reconnects."""
        with ending(self.source.disconnect):
            if self.interlock is not None:
                self.interlock.end()
