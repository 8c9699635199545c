"""Real-time loop of the simulation process: physics by the clock, in front of a camera that captures by the clock."""

from __future__ import annotations

import math
import signal
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Final

import cv2
import gymnasium as gym
import numpy as np
import numpy.typing as npt

from shape_obs_envs.d455 import D455Camera, D455Model, Light
from shape_obs_envs.mujoco.goal_env import ShapeGoalEnv
from shape_obs_envs.mujoco.workspace import Workspace
from shape_obs_envs.robots.frame_publisher import Captured, Failed, OccludingHand, SharedFrames, SimulationSpec, Started
from shape_obs_envs.sources.registration import RawImages

Array = npt.NDArray[np.float64]
#: Delay in seconds beyond which the loop does not catch up but pauses the simulated time.
_LARGEST_DELAY: Final = 0.25


@dataclass(frozen=True)
class Ramp:
    """A motion at constant speed that ends at a time limit; before and after it the robot stands still.

    Args:
        start: Pose at the beginning.
        end: Pose at the end, if there is enough time.
        begin: Start time: ``time.monotonic()`` in seconds, which all processes of a machine share.
        seconds: Duration; 0 for an immediate motion.
        until: Latest end, wherever the robot is then: ``time.monotonic()`` in seconds.
    """

    start: Array
    end: Array
    begin: float
    seconds: float
    until: float = math.inf

    def at(self, moment: float) -> Array:
        """Return the pose at a time of ``time.monotonic()``."""
        moving = min(moment, self.until) - self.begin
        if moving < 0:
            return self.start.copy()
        share = 1.0 if moving >= self.seconds else moving / self.seconds
        return self.start + share * (self.end - self.start)

    @property
    def final(self) -> Array:
        """Pose after the motion."""
        return self.at(math.inf)

    @classmethod
    def standing(cls, pose: Array, moment: float) -> Ramp:
        """Return a motion that stands still from a given time on."""
        return cls(pose, pose, moment, 0.0)


class RealtimeSimulation:
    """A simulated environment that is advanced one physics step at a time.

    Poses have shape ``(G, 3)``: x, y in metres and yaw in radians for each gripper of a rope or ring, and x, y, z in
    metres for those of a cloth or a hanging rope.

    Args:
        env: Id of a simulated environment, such as "ShapeObs/Cable-v0".
        **options: Arguments of the environment; its camera has 640 x 480 pixels by default.

    Raises:
        ValueError: The environment is not a simulated one, or an argument is out of its range.
        TypeError: It does not take an argument.

    Attributes:
        env: The environment.
        dt: Duration of a physics step in seconds.
    """

    def __init__(self, env: str, **options: Any) -> None:
        # Images are drawn on demand, not at each reset.
        try:
            made = gym.make(env, **{"camera": "d455", **options, "render_observation": False}).unwrapped
        except gym.error.Error as error:
            raise ValueError(f"env: {env!r} with {options} is not a simulated environment: {error}") from error
        if not isinstance(made, ShapeGoalEnv):
            raise ValueError(f"env: expected a simulated environment such as 'ShapeObs/Cable-v0', got {env!r}.")
        self.env: Any = made  # subclasses publish more than the base class
        self._body, self._steps = made._body, 0
        self.dt = self._body.timestep
        self._per_step = round(made.dt / self.dt)

    @property
    def workspace(self) -> Workspace:
        """Allowed poses of the grippers."""
        return self.env._workspace

    def restart(self, seed: int | None = None) -> Array:
        """Draw a new start, without a goal, and return the gripper poses ``(G, 3)``."""
        self.env.reset(seed=seed, options={"goal": self.env._goal})
        return self._body.gripper_targets().copy()

    def draw_goal(self, start: Array, seed: int | None = None) -> Array:
        """Reset to the state ``start`` and return the points ``(n, 3)``, in metres, of a goal reachable from it."""
        self.env.reset(seed=seed, options={"start": start})
        return self.env._goal.reshape(-1, 3).astype(np.float64)

    def state(self) -> Array:
        """Return the physics state."""
        return self.env.get_state()

    def advance(self, poses: Array) -> None:
        """Advance by one physics step with the grippers at ``poses`` ``(G, 3)``."""
        self._body.advance(poses)
        self._steps += 1
        if self._steps % self._per_step == 0:
            self.env._randomizer.advance()

    def capture(self) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]:
        """Render the present scene: RGB ``(H, W, 3)`` uint8, and depth ``(H, W)`` in metres."""
        self._body.refresh()
        return self.env._rendering.capture(self._body)

    def points(self) -> Array:
        """Return the true points ``(n, 3)`` of the object, in metres, at the last ``capture``."""
        return self.env._goal_points()

    def anchors(self) -> dict[str, tuple[float, ...]]:
        """Return where the grippers held the object at the last ``capture``: name -> (x, y, z) in metres."""
        return {name: tuple(place) for name, place in self.env.anchors.items()}

    def close(self) -> None:
        """Free the camera."""
        self.env.close()


class SimulationLoop:
    """Physics and camera of the simulation process.

    Orders are pairs: ("go", ``Ramp``), ("reset", seed or None), ("hand", (share, seed)), ("end", None).

    Args:
        spec: Parameters of the simulation.
        frames: Where images go.
        orders: Where orders come from.
        messages: Where ``Started`` and ``Captured`` go.
    """

    def __init__(self, spec: SimulationSpec, frames: SharedFrames, orders: Connection, messages: Connection) -> None:
        self._spec, self._frames, self._orders, self._messages = spec, frames, orders, messages
        self._simulation = RealtimeSimulation(spec.env, **spec.options)
        geometry, camera = spec.geometry, self._simulation.env.camera_model.intrinsics
        self._raw = RawImages(
            camera, geometry.colour, geometry.depth, geometry.rotation, geometry.translation, geometry.depth_unit
        )
        self._noise = _Noise(spec) if spec.noise else None
        self._hand = OccludingHand(0.0, 0)
        self._period, self._next = 1 / spec.fps, 0
        self._step, self._begin = 0, time.monotonic()
        self._capture()  # opens the camera and compiles before the clock starts
        self._restart(spec.seed)

    def run(self) -> None:
        """Run until the order to end.

        Raises:
            EOFError: The process that sends orders is gone.
        """
        self._begin = time.monotonic()
        while True:
            due = self._begin + (self._step + 1) * self._simulation.dt
            late = time.monotonic() - due
            if late > _LARGEST_DELAY:
                self._begin += late
                due += late
            if not self._execute_orders(due):
                break
            self._simulation.advance(self._ramp.at(due))
            self._step += 1
            self._publish_frame()
        self._simulation.close()

    def _execute_orders(self, due: float) -> bool:
        """Execute orders until the time ``due``; return whether to continue."""
        while self._orders.poll(max(0.0, due - time.monotonic())):
            order, what = self._orders.recv()
            if order == "end":
                return False
            if order == "go":
                self._ramp = what
            elif order == "hand":
                self._hand = OccludingHand(*what)
            else:
                begin = time.monotonic()
                self._restart(what)
                spent = time.monotonic() - begin
                self._begin, due = self._begin + spent, due + spent
        return True

    def _restart(self, seed: int | None) -> None:
        poses = self._simulation.restart(seed)
        self._ramp = Ramp.standing(poses, time.monotonic())
        self._messages.send(Started(poses, self._simulation.state(), self._simulation.anchors()))

    def _publish_frame(self) -> None:
        elapsed = self._step * self._simulation.dt
        if elapsed < self._next * self._period - 1e-9:
            return
        number = int(elapsed / self._period + 1e-6)
        self._next = number + 1
        if time.monotonic() > self._begin + self._next * self._period:
            return  # too late: a slow camera skips frames
        colour, depth, points, covered = self._capture()
        slot = self._frames.put(colour, depth)
        stamp = self._begin + elapsed
        self._messages.send(Captured(number, stamp, slot, points, self._simulation.anchors(), covered))

    def _capture(self) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint16], Array, bool]:
        """Return raw colour, raw depth, true points in metres, and whether a hand is in the image."""
        rgb, metres = self._simulation.capture()
        points = self._simulation.points()
        covered = self._hand.draw(rgb, metres, self._simulation.env.camera_model.project_from_base(points))
        colour, depth = self._raw(rgb, metres)
        return *((colour, depth) if self._noise is None else self._noise(colour, depth)), points, covered


class _Noise:
    """Noise of a D455 on raw images, which must have one size."""

    def __init__(self, spec: SimulationSpec) -> None:
        geometry = spec.geometry
        if geometry.colour.size != geometry.depth.size:
            raise ValueError(
                f"noise: expected colour and depth of one size, got {geometry.colour.size} and {geometry.depth.size}."
            )
        self._unit, self._random = geometry.depth_unit, np.random.default_rng([spec.seed or 0, 0xD455])
        self._camera = D455Camera(D455Model(), geometry.depth.size, fast=True)
        self._light = Light.draw(self._camera.model, self._random)

    def __call__(
        self, colour: npt.NDArray[np.uint8], depth: npt.NDArray[np.uint16]
    ) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint16]]:
        metres, _ = self._camera.measure(depth * np.float32(self._unit), colour, self._random)
        self._light = self._light.later(self._camera.model, self._random)
        units = np.rint(metres / self._unit)
        units[~((units > 0) & (units < 65536))] = 0
        return self._camera.colour(colour, self._light, self._random), units.astype(np.uint16)


def run_simulation(spec: SimulationSpec, frames: SharedFrames, orders: Connection, messages: Connection) -> None:
    """Run the simulation in its own process, until the parent process ends it or is gone."""
    # A terminal sends these signals to this process too, but the parent must park the robot first.
    for name in ("SIGINT", "SIGHUP", "SIGQUIT"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # by which the parent ends it, also where that ignores it itself
    cv2.setNumThreads(1)
    try:
        SimulationLoop(spec, frames, orders, messages).run()
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return  # the parent process is gone
    except (ValueError, RuntimeError, OSError, ImportError) as error:
        messages.send(Failed(str(error)))
        raise
