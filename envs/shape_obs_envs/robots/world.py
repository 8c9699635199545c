"""World: an environment that runs by the clock, before a camera that takes pictures by the clock."""

from __future__ import annotations

import signal
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs_envs.d455 import D455Camera, D455Model
from shape_obs_envs.d455.colour import Light
from shape_obs_envs.mujoco.stage import Stage
from shape_obs_envs.robots.hand import Hand
from shape_obs_envs.robots.ramp import Ramp
from shape_obs_envs.robots.slots import Slots
from shape_obs_envs.sources.raw_images import RawImages
from shape_obs_envs.sources.realsense.geometry import Geometry

Array = npt.NDArray[np.float64]
#: Seconds. Who is later than this does not catch up, but lets the world stand still meanwhile.
_HOPELESS: Final = 0.25


@dataclass(frozen=True)
class Plan:
    """What is to be simulated.

    Args:
        env: The environment's id.
        geometry: Of the raw images.
        fps: Pictures a second.
        seed: Of the first start and of the noise.
        noise: Whether pictures have a D455's noise.
        options: Of the environment.
    """

    env: str
    geometry: Geometry
    fps: float
    seed: int | None
    noise: bool
    options: Mapping[str, Any] = field(default_factory=dict)


class Started(NamedTuple):
    """A new start.

    Attributes:
        poses: (G,3) of the grippers.
        state: Of the physics.
        anchors: Where the grippers hold the object: name -> (x, y, z) [m], base frame.
    """

    poses: Array
    state: Array
    anchors: dict[str, tuple[float, ...]]


class Shot(NamedTuple):
    """A picture was taken.

    Attributes:
        period: The count of the camera's periods; gaps are pictures for which there was no time.
        stamp: ``time.monotonic()`` of the scene that it shows, seconds.
        slot: Where the images are; None where nobody took the last ones away.
        points: (n,3) [m] true points of the object, base frame.
        anchors: Where the grippers hold it: name -> (x, y, z) [m], base frame.
        covered: Whether a hand is in the picture.
    """

    period: int
    stamp: float
    slot: int | None
    points: Array
    anchors: dict[str, tuple[float, ...]]
    covered: bool


class Failed(NamedTuple):
    """The world came to an end."""

    reason: str


class World:
    """Physics and pictures by the clock.

    Orders, as pairs: ("go", `Ramp`), ("reset", seed or None), ("hand", (share, seed)), ("end", None).

    Args:
        plan: What is to be simulated.
        slots: Where pictures go.
        orders: Where orders come from.
        notices: Where `Started` and `Shot` go.
    """

    def __init__(self, plan: Plan, slots: Slots, orders: Connection, notices: Connection) -> None:
        self._plan, self._slots, self._orders, self._notices = plan, slots, orders, notices
        self._stage = Stage(plan.env, **plan.options)
        geometry, camera = plan.geometry, self._stage.env.camera_model.intrinsics
        self._raw = RawImages(
            camera, geometry.colour, geometry.depth, geometry.rotation, geometry.translation, geometry.depth_unit
        )
        self._noise = _Noise(plan) if plan.noise else None
        self._hand = Hand(0.0, 0)
        self._period, self._next = 1 / plan.fps, 0
        self._step, self._begin = 0, time.monotonic()
        self._look()  # opens the camera and compiles, before time counts
        self._restart(plan.seed)

    def run(self) -> None:
        """Go on until the order to end comes.

        Raises:
            EOFError: Nobody is there any more who could give it.
        """
        self._begin = time.monotonic()
        while True:
            due = self._begin + (self._step + 1) * self._stage.dt
            late = time.monotonic() - due
            if late > _HOPELESS:
                self._begin += late
                due += late
            if not self._obey(due):
                break
            self._stage.advance(self._ramp.at(due))
            self._step += 1
            self._take_picture()
        self._stage.close()

    def _obey(self, due: float) -> bool:
        """Carry orders out until a moment comes; whether to go on after that."""
        while self._orders.poll(max(0.0, due - time.monotonic())):
            order, what = self._orders.recv()
            if order == "end":
                return False
            if order == "go":
                self._ramp = what
            elif order == "hand":
                self._hand = Hand(*what)
            else:
                begin = time.monotonic()
                self._restart(what)
                spent = time.monotonic() - begin
                self._begin, due = self._begin + spent, due + spent
        return True

    def _restart(self, seed: int | None) -> None:
        poses = self._stage.restart(seed)
        self._ramp = Ramp.standing(poses, time.monotonic())
        self._notices.send(Started(poses, self._stage.state(), self._stage.anchors()))

    def _take_picture(self) -> None:
        elapsed = self._step * self._stage.dt
        if elapsed < self._next * self._period - 1e-9:
            return
        number = int(elapsed / self._period + 1e-6)
        self._next = number + 1
        if time.monotonic() > self._begin + self._next * self._period:
            return  # too late for this one: a camera that is too slow leaves pictures out
        colour, depth, points, covered = self._look()
        slot = self._slots.put(colour, depth)
        stamp = self._begin + elapsed
        self._notices.send(Shot(number, stamp, slot, points, self._stage.anchors(), covered))

    def _look(self) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint16], Array, bool]:
        """Raw colour, raw depth, true points [m], and whether a hand is in the picture."""
        rgb, metres = self._stage.look()
        points = self._stage.points()
        covered = self._hand.draw(rgb, metres, self._stage.env.camera_model.project_from_base(points))
        colour, depth = self._raw(rgb, metres)
        return *((colour, depth) if self._noise is None else self._noise(colour, depth)), points, covered


class _Noise:
    """A D455's noise on raw images, which both have one size."""

    def __init__(self, plan: Plan) -> None:
        geometry = plan.geometry
        if geometry.colour.size != geometry.depth.size:
            raise ValueError(
                f"noise: expected colour and depth of one size, got {geometry.colour.size} and {geometry.depth.size}."
            )
        self._unit, self._random = geometry.depth_unit, np.random.default_rng([plan.seed or 0, 0xD455])
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


def run_world(plan: Plan, slots: Slots, orders: Connection, notices: Connection) -> None:
    """Run the simulation in a process of its own, until the process that started it ends it or is gone."""
    for name in (
        "SIGINT",
        "SIGHUP",
        "SIGQUIT",
    ):  # a terminal sends these to this process too; the other one parks first
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    cv2.setNumThreads(1)
    try:
        World(plan, slots, orders, notices).run()
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return  # the robot's process is gone
    except (ValueError, RuntimeError, OSError, ImportError) as error:
        notices.send(Failed(str(error)))
        raise
