"""A robot that moves a simulated object in real time, in front of a software D455."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraModel
from shape_obs.extrinsics import Extrinsics
from shape_obs.robot import ActionSpec, RobotError
from shape_obs.utils.errors import hint_at_argument
from shape_obs_envs.arguments import count
from shape_obs_envs.robots.frame_publisher import Faults, FramePublisher, SimulationSpec, Started, check_occluder
from shape_obs_envs.robots.null import checked_motion
from shape_obs_envs.robots.simulation_loop import Ramp, RealtimeSimulation
from shape_obs_envs.robots.simulation_process import SimulationProcess
from shape_obs_envs.sources.env import class_of
from shape_obs_envs.sources.realsense import RealSenseSource, SoftwareD455

Array = npt.NDArray[np.float64]
#: Duration of the way to the parking position in seconds.
_HOME: Final = 1.0


class SimulatedRobot:
    """Move a simulated object in real time, in front of a ``SoftwareD455``.

    A whole deployment runs without hardware this way: a ``RealSenseSource`` on ``camera`` shows the scene, and its
    images pass through librealsense, rectification and alignment like those of a real camera. Physics and rendering run
    in their own process; here a thread only passes on raw images. The environment's camera sees slightly less than a
    D455: up to 8 pixels at the edges are black and without depth. Depth is also missing where an object in front
    occludes it from the depth camera.

    The coordinates are those of the grippers, ``gripper0/x`` and so on: x, y in metres and yaw in radians in the base
    frame for rope and ring, and x, y, z in metres for cloth and hanging rope. A motion takes ``ramp`` seconds and ends
    at its ``until`` by the simulation's clock, wherever it is then. Targets are clipped to the environment's workspace,
    for both grippers together, so that they neither tear the object nor push it into loops.

    The process is started by Python's ``multiprocessing``: guard a script that uses this class with
    ``if __name__ == "__main__":``.

    Args:
        env: Id of a simulated environment: "ShapeObs/Cable-v0", "ShapeObs/Cables-v0", "ShapeObs/Ring-v0",
            "ShapeObs/Cloth-v0" or "ShapeObs/Hanging-v0".
        camera: The camera; None for a new ``SoftwareD455``.
        fps: Frames per second. A slow computer captures fewer; see ``pace``.
        seed: Seed of the first start and of the noise; later starts continue the sequence.
        noise: Whether images have the noise of a D455.
        ramp: Duration of a motion in seconds.
        **options: Arguments of the environment, such as ``grippers=1``, ``renderer="rays"`` or ``difficulty="near"``.

    Attributes:
        action_spec: Meaning of actions: displacements, scaled as in the environment.
        camera: The software camera.

    Raises:
        ValueError: An argument is invalid, or the environment is not a simulated one.
        ImportError: MuJoCo or librealsense is not installed.

    Example:
        >>> robot = SimulatedRobot(seed=1)  # doctest: +SKIP
        >>> env = gym.make("ShapeObs/D455-v0", source="robot", robot=robot)  # doctest: +SKIP
    """

    action_spec: ActionSpec
    camera: SoftwareD455
    name = "simulated"

    def __init__(
        self,
        env: str = "ShapeObs/Cable-v0",
        camera: SoftwareD455 | None = None,
        fps: float = 30,
        seed: int | None = 0,
        noise: bool = False,
        *,
        ramp: float = 0.05,
        **options: Any,
    ) -> None:
        if not 1 <= fps <= 90:
            raise ValueError(f"fps: expected 1 to 90 frames per second, got {fps}.")
        if not 0 < ramp < 10:
            raise ValueError(f"ramp: expected seconds above 0 and below 10, got {ramp}.")
        if seed is not None:
            seed = count("seed", seed, 0)
        self._ramp_seconds = float(ramp)
        try:
            self._model = RealtimeSimulation(env, **options)  # for its metadata and goals only; it does not run
        except TypeError as error:
            cause = error.__cause__ or error  # Gymnasium's own message repeats all arguments
            hint = hint_at_argument(cause, SimulatedRobot, class_of(env)) if options else ""
            raise ValueError(f"env: {env!r} with {options} is not a simulated environment: {cause}{hint}") from error
        self.camera = SoftwareD455(fps=round(fps)) if camera is None else camera
        self._spec = SimulationSpec(env, self.camera.geometry, float(fps), seed, bool(noise), options)
        self.action_spec = self._model.env.action_spec
        self._lock = threading.RLock()
        self._process: SimulationProcess | None = None
        self._home = np.zeros((len(self.action_spec) // 3, 3))
        self._motion, self._fresh = Ramp.standing(self._home, time.monotonic()), True
        self._start: Array | None = None
        self._goal: Array | None = None
        self._publisher = FramePublisher(self.camera, float(fps))

    # ---- the robot

    def connect(self) -> None:
        """Start the simulation unless it runs; the camera delivers frames from then on.

        Raises:
            RobotError: The simulation does not start.
        """
        if self._process is not None and self._process.alive:
            return
        self.disconnect()
        process = SimulationProcess(self._spec, self._publisher.publish)
        with self._lock:
            self._process = process
            self._begin(process.started)

    def reset(self) -> None:
        """Draw a new start; the first one after ``connect`` uses ``seed``.

        Raises:
            RobotError: It is not connected, or the simulation has ended.
        """
        process = self._connected()
        seed = self._spec.seed if self._fresh else None
        started = process.restart(seed)
        with self._lock:
            self._begin(started)
            self._fresh = False

    def send(self, action: Array, until: float) -> None:
        """Begin a motion ``(A,)`` in physical units that ends at ``until``; it replaces the previous one.

        Raises:
            RobotError: It is not connected, the simulation has ended, or the motion is invalid.
        """
        motion = checked_motion(action, self.action_spec)
        with self._lock:  # a stop in another thread must not be undone
            target = self._motion.final
            self._go(target + motion.reshape(target.shape), self._ramp_seconds, until)

    def state(self) -> Array:
        """Return the end of the present motion: coordinates ``(A,)`` of the grippers in metres and radians."""
        return self._motion.final.ravel()

    def stop(self) -> None:
        """Stop at the present position."""
        with self._lock:
            if self._process is None:
                return
            now = time.monotonic()
            try:
                self._process.order("go", Ramp.standing(self._motion.at(now), now))
            except RobotError:
                return  # an ended simulation stands still
            self._motion = Ramp.standing(self._motion.at(now), now)

    def park(self) -> None:
        """Return to the start of the episode.

        Raises:
            RobotError: It is not connected, the simulation has ended, or it was stopped on the way.
        """
        way = self._go(self._home, _HOME)
        time.sleep(_HOME)
        self._connected().check()
        if self._motion is not way:
            raise RobotError("The simulated robot was stopped or moved on its way to the parking position.")

    def disconnect(self) -> None:
        """End the simulation and its process."""
        with self._lock:
            process, self._process = self._process, None
        if process is not None:
            process.close()

    # ---- the camera

    def source(self) -> RealSenseSource:
        """Return a source that reads the camera and has its extrinsics; it is not connected yet."""
        height, width = self.camera.geometry.colour.size
        return RealSenseSource(self.camera, width=width, height=height, fps=self.camera.fps, extrinsics=self.extrinsics)

    @property
    def extrinsics(self) -> Extrinsics:
        """Pose of the camera in the base frame."""
        transform = self.camera_model.transform_camera_to_base
        assert transform is not None
        return Extrinsics(tuple(tuple(float(value) for value in row) for row in transform))

    @property
    def camera_model(self) -> CameraModel:
        """Intrinsics of the camera's rectified images, and its pose in the base frame."""
        pinhole = replace(self.camera.geometry.colour, model="pinhole", coeffs=(0.0,) * 5)
        return CameraModel(pinhole, self._model.env.camera_model.transform_camera_to_base)

    @property
    def pace(self) -> float:
        """Measured frames per second; 0 before the second frame."""
        return self._publisher.rate

    def disturb(
        self,
        drop: float = 0.0,
        delay: float = 0.0,
        freeze: float = 0.0,
        black: float = 0.0,
        occluder: float = 0.0,
        seed: int = 0,
    ) -> None:
        """Inject faults into the frames from now on; without arguments, stop injecting faults.

        Args:
            drop: Fraction of frames that are lost.
            delay: Fraction of frames that are 50 to 150 ms late, as are the frames that wait behind them.
            freeze: Fraction of frames without a new colour image, while depth continues.
            black: Fraction of frames with a black colour image.
            occluder: Fraction of the time that a hand covers the object, for a second each.
            seed: Seed of the choice of frames.

        Raises:
            ValueError: A fraction is out of its range.
            RobotError: It is not connected, or the simulation has ended.
        """
        faults = Faults(drop, delay, freeze, black, seed)
        check_occluder(occluder)
        self._connected().order("hand", (occluder, seed))
        faults.affected = self._publisher.faults.affected
        self._publisher.faults = faults

    @property
    def affected(self) -> dict[str, list[int]]:
        """The numbers of the affected frames of each fault, "drop", "delay", "freeze", "black" and "occluder"."""
        return {kind: list(numbers) for kind, numbers in self._publisher.faults.affected.items()}

    # ---- the object

    @property
    def anchors(self) -> Mapping[str, tuple[float, ...]]:
        """The ``(x, y, z)`` of each gripper in the last frame by its name, in metres in the base frame."""
        return self._publisher.anchors

    def truth(self, number: int) -> Array:
        """Return the object's true points ``(n, 3)`` in a frame, in metres, base frame, laid out like a goal.

        Args:
            number: ``Frame.number``.

        Raises:
            KeyError: There was no such frame, or it was more than 9000 frames ago.
        """
        return self._publisher.truth(number)

    @property
    def goal(self) -> Array:
        """Points ``(n, 3)`` of a goal that can be reached from the last start, in metres, base frame.

        The first access draws it, which takes up to a second.

        Raises:
            RobotError: The robot has not been connected yet.
        """
        if self._goal is None:
            if self._start is None:
                raise RobotError("The simulated robot has no start yet: call connect() first.")
            self._goal = self._model.draw_goal(self._start, self._spec.seed)
        return self._goal.copy()

    @property
    def goal_layout(self) -> Mapping[str, Any]:
        """Layout of the points of goal and truth."""
        return self._model.env.goal_layout

    @property
    def shape_obs_defaults(self) -> Mapping[str, Any]:
        """Suitable arguments of ``shape_obs.ShapeObservation`` for the object."""
        return self._model.env.shape_obs_defaults

    # ---- internal

    def _connected(self) -> SimulationProcess:
        if self._process is None:
            raise RobotError("The simulated robot is not connected: call connect() first.")
        return self._process

    def _begin(self, started: Started) -> None:
        self._home = started.poses
        self._motion = Ramp.standing(started.poses, time.monotonic())
        self._start, self._goal = started.state, None
        self._fresh = True
        self._publisher.begin(started.anchors)

    def _go(self, poses: Array, seconds: float, until: float = math.inf) -> Ramp:
        with self._lock:
            process, now = self._connected(), time.monotonic()
            poses = self._model.workspace.clip(poses, self._motion.final)
            motion = Ramp(self._motion.at(now), poses, now, seconds, max(until, now))
            process.order("go", motion)
            self._motion = motion
            return motion
