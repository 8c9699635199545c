"""Publish the frames of a simulation to a software camera, with faults and a hand in the image on request."""

from __future__ import annotations

import ctypes
import logging
import threading
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from multiprocessing.context import SpawnContext
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs_envs.sources.realsense import SoftwareD455
from shape_obs_envs.sources.realsense.driver import Geometry

Array = npt.NDArray[np.float64]
RawPair = tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint16]]
#: Largest number of queued image pairs: a quarter of a second at 30 Hz.
_COUNT: Final = 8

_LOG: Final = logging.getLogger(__name__)
#: Number of frames whose truth is stored (five minutes at 30 Hz), and of faults.
_STORED: Final = 9000
_STORED_FAULTS: Final = 100_000
#: Number of frames over which the frame rate is measured.
_WINDOW: Final = 60
_FAULTS: Final = ("drop", "delay", "freeze", "black")
#: Shortest and longest delay of a late frame in seconds; the frames after it wait, as on a cable.
_DELAY: Final = (0.05, 0.15)

_SKIN: Final = (205, 150, 125)
_HEIGHT: Final = 0.06  # of the hand above the table, in metres
_WIDTH: Final = 56  # pixels at 480 rows
#: Frames that a hand stays, and frames of its arrival and departure.
_STAY: Final = 30
_MOVING: Final = 6


@dataclass(frozen=True)
class SimulationSpec:
    """Parameters of a simulation.

    Args:
        env: Id of the environment.
        geometry: Geometry of the raw images.
        fps: Frames per second.
        seed: Seed of the first start and of the noise.
        noise: Whether images have the noise of a D455.
        options: Arguments of the environment.
    """

    env: str
    geometry: Geometry
    fps: float
    seed: int | None
    noise: bool
    options: Mapping[str, Any] = field(default_factory=dict)


class Started(NamedTuple):
    """Message: a new start.

    Attributes:
        poses: Gripper poses, shape ``(G, 3)``.
        state: Physics state.
        anchors: Where the grippers hold the object: name -> (x, y, z) in metres, base frame.
    """

    poses: Array
    state: Array
    anchors: dict[str, tuple[float, ...]]


class Captured(NamedTuple):
    """Message: a frame was captured.

    Attributes:
        period: Number of the camera period; gaps are frames that were skipped for lack of time.
        stamp: ``time.monotonic()`` of the scene in seconds.
        slot: Index of the images in shared memory; None if the queue was full.
        points: True points of the object, shape ``(n, 3)``, in metres, base frame.
        anchors: Where the grippers hold the object: name -> (x, y, z) in metres, base frame.
        covered: Whether a hand is in the image.
    """

    period: int
    stamp: float
    slot: int | None
    points: Array
    anchors: dict[str, tuple[float, ...]]
    covered: bool


class Failed(NamedTuple):
    """Message: the simulation ended with an error."""

    reason: str


class SharedFrames:
    """A ring buffer of raw image pairs in shared memory, written by one process and read by another.

    Args:
        context: Multiprocessing context of the processes.
        colour: Size ``(H, W)`` of the colour images.
        depth: Size ``(H, W)`` of the depth images.
    """

    def __init__(self, context: SpawnContext, colour: tuple[int, int], depth: tuple[int, int]) -> None:
        self._sizes = colour, depth
        self._colours: Any = context.RawArray(ctypes.c_uint8, _COUNT * colour[0] * colour[1] * 3)
        self._depths: Any = context.RawArray(ctypes.c_uint16, _COUNT * depth[0] * depth[1])
        self._free: Any = context.Semaphore(_COUNT)
        self._next = 0

    def put(self, colour: npt.NDArray[np.uint8], depth: npt.NDArray[np.uint16]) -> int | None:
        """Copy a pair into the next slot and return its index; None if all slots are full."""
        if not self._free.acquire(block=False):
            return None
        slot, self._next = self._next, (self._next + 1) % _COUNT
        into_colour, into_depth = self.get(slot)
        into_colour[:], into_depth[:] = colour, depth
        return slot

    def get(self, slot: int) -> RawPair:
        """Return the pair in a slot without copying: colour ``(H, W, 3)`` uint8 and depth ``(H, W)`` uint16."""
        colour, depth = self._sizes
        colours = np.frombuffer(self._colours, np.uint8).reshape(_COUNT, *colour, 3)
        return colours[slot], np.frombuffer(self._depths, np.uint16).reshape(_COUNT, *depth)[slot]

    def release(self) -> None:
        """Free the oldest full slot."""
        self._free.release()


@dataclass
class Faults:
    """Fractions of frames with a fault. A frame has at most one fault; any frame may also show a hand.

    Args:
        drop: Fraction of lost frames.
        delay: Fraction of frames that are 50 to 150 ms late.
        freeze: Fraction of frames without a new colour image, while depth continues.
        black: Fraction of frames with a black colour image.
        seed: Seed of the choice of frames.

    Attributes:
        affected: Fault -> numbers of the affected frames; "occluder" for those with a hand.

    Raises:
        ValueError: A fraction is below 0, or their sum is above 1.
    """

    drop: float = 0.0
    delay: float = 0.0
    freeze: float = 0.0
    black: float = 0.0
    seed: int = 0
    affected: dict[str, deque[int]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        shares = [getattr(self, kind) for kind in _FAULTS]
        if min(shares) < 0 or sum(shares) > 1:
            given = ", ".join(f"{kind}={share}" for kind, share in zip(_FAULTS, shares, strict=True))
            raise ValueError(f"expected shares from 0 to 1, with a sum of at most 1, got {given}.")
        self._random = np.random.default_rng([self.seed, 0xFA17])

    def draw(self) -> str:
        """Draw the fault of the next frame: "drop", "delay", "freeze" or "black", or an empty string."""
        drawn = self._random.random()
        for kind in _FAULTS:
            drawn -= getattr(self, kind)
            if drawn < 0:
                return kind
        return ""

    def draw_delay(self) -> float:
        """Draw the delay of the next late frame in seconds."""
        return float(self._random.uniform(*_DELAY))

    def record(self, kind: str, number: int) -> None:
        """Record a fault of a frame."""
        self.affected.setdefault(kind, deque(maxlen=_STORED_FAULTS)).append(number)


class FramePublisher:
    """Push frames into a camera, with faults on request, and store their true points.

    Args:
        camera: The camera.
        fps: Requested frames per second.

    Attributes:
        faults: Faults to inject.
        anchors: Where the grippers held the object in the last frame: name -> (x, y, z) in metres, base frame.
    """

    def __init__(self, camera: SoftwareD455, fps: float) -> None:
        self._camera, self._fps = camera, fps
        self.faults = Faults()
        self.anchors: dict[str, tuple[float, ...]] = {}
        self._truth: dict[int, Array] = {}
        self._stamps: deque[float] = deque(maxlen=_WINDOW)
        self._publishing, self._warned = threading.Lock(), False

    def begin(self, anchors: dict[str, tuple[float, ...]]) -> None:
        """Begin a new episode, in which the object is held at ``anchors``."""
        self.anchors = anchors
        self._stamps.clear()

    def publish(self, captured: Captured, pair: RawPair | None) -> None:
        """Push one frame into the camera, in the calling thread."""
        self._stamps.append(captured.stamp)
        self._check_rate()
        if pair is None:
            return
        colour, depth = pair
        faults, camera = self.faults, self._camera
        fault = faults.draw()
        if fault == "delay":
            time.sleep(faults.draw_delay())
        elif fault == "drop":
            camera.drop()
        elif fault == "freeze":
            camera.freeze_colour()
        elif fault == "black":
            colour = np.zeros_like(colour)
        with self._publishing:  # a reader of the frame who asks for its truth has to wait
            self.anchors = captured.anchors
            number = camera.push_raw(colour, depth, stamp=captured.stamp)
            self._truth[number] = captured.points
            if len(self._truth) > _STORED:
                del self._truth[next(iter(self._truth))]
        if fault == "freeze":
            camera.freeze_colour(False)
        for kind in [fault] * bool(fault) + ["occluder"] * captured.covered:
            faults.record(kind, number)

    def truth(self, number: int) -> Array:
        """Return the true points ``(n, 3)`` of a frame, in metres, base frame.

        Raises:
            KeyError: There was no such frame, or it was more than 9000 frames ago.
        """
        with self._publishing:
            if number not in self._truth:
                raise KeyError(f"no frame {number} is stored; {len(self._truth)} are")
            return self._truth[number].copy()

    @property
    def rate(self) -> float:
        """Measured frames per second; 0 before the second frame."""
        stamps = list(self._stamps)
        return (len(stamps) - 1) / (stamps[-1] - stamps[0]) if len(stamps) > 1 else 0.0

    def _check_rate(self) -> None:
        if self._warned or len(self._stamps) < _WINDOW or self.rate > 0.9 * self._fps:
            return
        self._warned = True
        _LOG.warning(
            "The simulation captures %.1f frames per second instead of %g: choose a lower fps, or a faster renderer.",
            self.rate,
            self._fps,
        )


class OccludingHand:
    """An arm that occasionally reaches from the lower edge of the image to a point of the object.

    Args:
        share: Fraction of the time that it is in the image, 0 ... 1; a visit takes a second at 30 Hz.
        seed: Seed of its visits and targets.

    Raises:
        ValueError: ``share`` is out of its range.
    """

    def __init__(self, share: float, seed: int) -> None:
        check_occluder(share)
        # Visits of _STAY frames, with breaks between them that result in this fraction.
        self._probability = 0.0 if share == 0 else min(1.0, share / (1 - share) / _STAY)
        self._random = np.random.default_rng([seed, 0x4A4D])
        self._frame, self._target = _STAY, 0.0

    def draw(self, rgb: npt.NDArray[np.uint8], metres: npt.NDArray[np.float32], points: npt.NDArray[Any]) -> bool:
        """Draw the arm into the next image, if it is there.

        Args:
            rgb: Image of shape ``(H, W, 3)``, uint8; modified.
            metres: Depth of shape ``(H, W)``; modified.
            points: Pixels of the object, shape ``(n, 2)``, in order.

        Returns:
            Whether any part of the arm is in the image.
        """
        if self._frame >= _STAY:
            if self._random.random() >= self._probability:
                return False
            self._frame, self._target = 0, self._random.uniform(0, len(points) - 1)
        height, width = metres.shape
        target, outside = points[round(self._target)], np.array([0.5 * width, 1.2 * height])
        share = min(1.0, (self._frame + 1) / _MOVING, (_STAY - self._frame) / _MOVING)
        tip = outside + share * (target - outside)
        self._frame += 1
        mask = np.zeros(metres.shape, np.uint8)
        begin, end = ((round(float(u)), round(float(v))) for u, v in (outside, tip))
        cv2.line(mask, begin, end, 1, round(_WIDTH * height / 480))
        covered = mask > 0
        if not covered.any():
            return False
        rgb[covered] = _SKIN
        metres[covered] = np.maximum(metres[covered] - np.float32(_HEIGHT), np.float32(0.05))
        return True


def check_occluder(share: float) -> None:
    """Check the fraction of time that a hand is in the image.

    Raises:
        ValueError: It is out of its range.
    """
    if not 0 <= share < 1:
        raise ValueError(f"occluder: expected a share from 0 (never) to below 1, got {share}.")
