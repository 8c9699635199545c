"""SimulatedRobot: a robot that moves a simulated rope in real time, before a software D455."""

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
from shape_obs_envs.mujoco.stage import Stage
from shape_obs_envs.robots.coordinates import checked_motion
from shape_obs_envs.robots.faults import Faults
from shape_obs_envs.robots.footage import Footage
from shape_obs_envs.robots.link import Link
from shape_obs_envs.robots.ramp import Ramp
from shape_obs_envs.robots.world import Plan, Started
from shape_obs_envs.sources.realsense import RealSenseSource, SoftwareD455

Array = npt.NDArray[np.float64]
#: Seconds to the place where it may be left alone.
_HOME: Final = 1.0


class SimulatedRobot:
    """Moves one of the simulated objects in real time, while a `SoftwareD455` looks.

    So a whole deployment runs without hardware: what a `RealSenseSource` reads from ``camera`` shows the scene, and
    goes through librealsense, rectification and alignment as a real camera's images do. Physics and drawing have a
    process of their own; here only a thread passes raw images on. The environment's camera sees a little less than a
    D455 does: up to 8 pixels at the edges are black and without depth. Depth is also missing where something in front
    hides it from the depth camera.

    Coordinates are those of the grippers, ``gripper0/x`` and so on: x, y [m] and yaw [rad] in the base frame for the
    rope and the ring, x, y, z [m] for the cloth. A motion takes ``ramp`` seconds, and ends at its ``until`` by the
    simulation's clock, wherever it is then. Targets are clipped to where the environment lets its grippers go, both
    together: so that they neither tear the object nor push it into loops.

    It starts a process as Python's ``multiprocessing`` does: a script that uses it keeps its own work under
    ``if __name__ == "__main__":``.

    Args:
        env: "ShapeObs/Cable-v0", "ShapeObs/Ring-v0" or "ShapeObs/Cloth-v0".
        camera: Who looks; None for a `SoftwareD455` of its own.
        fps: Pictures a second. A computer that is too slow for them takes fewer; see `pace`.
        seed: Of the first start and of the noise; later starts go on from there.
        noise: Whether pictures have a D455's noise.
        ramp: Seconds that a motion takes.
        **options: Of the environment, such as ``grippers=1``, ``renderer="rays"`` or ``difficulty="near"``.

    Attributes:
        action_spec: What actions mean: displacements, 1 is what it is in the environment.
        camera: The software camera.

    Raises:
        ValueError: An argument that makes no sense, or another environment.
        ImportError: MuJoCo or librealsense is missing; the message says how to get it.

    Example:
        >>> robot = SimulatedRobot(seed=1)  # doctest: +SKIP
        >>> env = gym.make("ShapeObs/D455-v0", source="robot", robot=robot)  # doctest: +SKIP
    """

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
            raise ValueError(f"fps: expected 1 to 90 pictures a second, got {fps}.")
        if not 0 < ramp < 10:
            raise ValueError(f"ramp: expected seconds above 0 and below 10, got {ramp}.")
        self._ramp_seconds = float(ramp)
        self._stage = Stage(env, **options)  # for what it publishes; nothing moves and nobody looks here
        self.camera = SoftwareD455(fps=round(fps)) if camera is None else camera
        self._plan = Plan(env, self.camera.geometry, float(fps), seed, bool(noise), options)
        self.action_spec: ActionSpec = self._stage.env.action_spec
        self._lock = threading.RLock()
        self._link: Link | None = None
        self._home = np.zeros((len(self.action_spec) // 3, 3))
        self._motion, self._fresh = Ramp.standing(self._home, time.monotonic()), True
        self._start: Array | None = None
        self._goal: Array | None = None
        self._footage = Footage(self.camera, float(fps))

    # ---- the robot

    def connect(self) -> None:
        """Start the simulation where none runs: the object lies there, and the camera takes pictures.

        Raises:
            RobotError: It does not start.
        """
        if self._link is not None and self._link.alive:
            return
        self.disconnect()
        link = Link(self._plan, self._footage.take)
        with self._lock:
            self._link = link
            self._begin(link.started)

    def reset(self) -> None:
        """Draw a new start; the first one after `connect` is that of ``seed``.

        Raises:
            RobotError: It is not connected, or the simulation has ended.
        """
        link = self._connected()
        seed = self._plan.seed if self._fresh else None
        started = link.restart(seed)
        with self._lock:
            self._begin(started)
            self._fresh = False

    def send(self, action: Array, until: float) -> None:
        """Begin a motion (A,) in physical units that ends at ``until``; it replaces the one before.

        Raises:
            RobotError: It is not connected, the simulation has ended, or this is no motion.
        """
        motion = checked_motion(action, self.action_spec)
        with self._lock:  # a stop in another thread is not undone
            told = self._motion.final
            self._go(told + motion.reshape(told.shape), self._ramp_seconds, until)

    def state(self) -> Array:
        """Return where the present motion ends: (A,), x, y [m] and yaw [rad] of each gripper."""
        return self._motion.final.ravel()

    def stop(self) -> None:
        """Stand still where it is now."""
        with self._lock:
            if self._link is None:
                return
            now = time.monotonic()
            try:
                self._link.order("go", Ramp.standing(self._motion.at(now), now))
            except RobotError:
                return  # what has ended stands still
            self._motion = Ramp.standing(self._motion.at(now), now)

    def park(self) -> None:
        """Go back to where the episode began.

        Raises:
            RobotError: It is not connected, the simulation has ended, or it was stopped on the way.
        """
        way = self._go(self._home, _HOME)
        time.sleep(_HOME)
        self._connected().check()
        if self._motion is not way:
            raise RobotError("The simulated robot was stopped or moved on its way to the place where it parks.")

    def disconnect(self) -> None:
        """End the simulation; its process is gone when this returns."""
        with self._lock:
            link, self._link = self._link, None
        if link is not None:
            link.close()

    # ---- the camera

    def source(self) -> RealSenseSource:
        """A source that reads its camera and knows where that stands; not yet connected."""
        height, width = self.camera.geometry.colour.size
        return RealSenseSource(self.camera, width=width, height=height, fps=self.camera.fps, extrinsics=self.extrinsics)

    @property
    def extrinsics(self) -> Extrinsics:
        """Where the camera stands in the base frame."""
        transform = self.camera_model.transform_camera_to_base
        assert transform is not None
        return Extrinsics(tuple(tuple(float(value) for value in row) for row in transform))

    @property
    def camera_model(self) -> CameraModel:
        """Intrinsics of the camera's rectified images, and its place in the base frame."""
        pinhole = replace(self.camera.geometry.colour, model="pinhole", coeffs=(0.0,) * 5)
        return CameraModel(pinhole, self._stage.env.camera_model.transform_camera_to_base)

    @property
    def pace(self) -> float:
        """Pictures a second, over the last ones; 0 before there are two."""
        return self._footage.pace

    def disturb(
        self,
        drop: float = 0.0,
        delay: float = 0.0,
        freeze: float = 0.0,
        black: float = 0.0,
        occluder: float = 0.0,
        seed: int = 0,
    ) -> None:
        """From now on have things go wrong with the pictures; without arguments nothing more does.

        Args:
            drop: Share of the frames that are lost.
            delay: Share that is 50 to 150 ms late, with those behind them.
            freeze: Share without a new colour image, while depth goes on.
            black: Share with a black colour image.
            occluder: Share of the time that a hand lies over the object, a second at a time.
            seed: Of when that is.

        Raises:
            ValueError: Shares that are none.
            RobotError: It is not connected, or the simulation has ended.
        """
        faults = Faults(drop, delay, freeze, black, seed)
        if not 0 <= occluder < 1:
            raise ValueError(f"occluder: expected a share from 0 (never) to below 1, got {occluder}.")
        self._connected().order("hand", (occluder, seed))
        faults.affected = self._footage.faults.affected
        self._footage.faults = faults

    @property
    def affected(self) -> dict[str, list[int]]:
        """Fault -> numbers of the frames that had it: "drop", "delay", "freeze", "black", "occluder"."""
        return {kind: list(numbers) for kind, numbers in self._footage.faults.affected.items()}

    # ---- what is known of the object

    @property
    def anchors(self) -> Mapping[str, tuple[float, ...]]:
        """Where the grippers hold the object in the last picture: name -> (x, y, z) [m], base frame."""
        return self._footage.anchors

    def truth(self, number: int) -> Array:
        """True points (n,3) [m] of the object, base frame, in a frame; those that its environment's goals have.

        Args:
            number: ``Frame.number``.

        Raises:
            KeyError: No such frame was taken, or more than 9000 frames ago.
        """
        return self._footage.truth(number)

    @property
    def goal(self) -> Array:
        """Points (n,3) [m] of a goal that can be reached from the last start, base frame.

        It is drawn when it is asked for, which takes up to a second.

        Raises:
            RobotError: It has not been connected yet.
        """
        if self._goal is None:
            if self._start is None:
                raise RobotError("The simulated robot has no start yet: call connect() first.")
            self._goal = self._stage.draw_goal(self._start, self._plan.seed)
        return self._goal.copy()

    @property
    def goal_layout(self) -> Mapping[str, Any]:
        """How the points of goal and truth are laid out."""
        return self._stage.env.goal_layout

    @property
    def shape_obs_defaults(self) -> Mapping[str, Any]:
        """Arguments of `shape_obs.ShapeObservation` that suit the object."""
        return self._stage.env.shape_obs_defaults

    # ---- inside

    def _connected(self) -> Link:
        if self._link is None:
            raise RobotError("The simulated robot is not connected: call connect() first.")
        return self._link

    def _begin(self, started: Started) -> None:
        self._home = started.poses
        self._motion = Ramp.standing(started.poses, time.monotonic())
        self._start, self._goal = started.state, None
        self._fresh = True
        self._footage.begin(started.anchors)

    def _go(self, poses: Array, seconds: float, until: float = math.inf) -> Ramp:
        with self._lock:
            link, now = self._connected(), time.monotonic()
            poses = self._stage.workspace.clip(poses, self._motion.final)
            motion = Ramp(self._motion.at(now), poses, now, seconds, max(until, now))
            link.order("go", motion)
            self._motion = motion
            return motion
