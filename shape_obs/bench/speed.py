"""Time each stage on this machine: a rope from mask, image and RGB-D image to points, and simulated steps.

OpenCV's usual way from an image to a mask is timed on the same frames, as a reference for other machines.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing
from typing import Any, Final, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.photos import BLUE, Scene, photograph
from shape_obs.bench.report import CLOCKS
from shape_obs.bench.scenes import SIZE, Rope, draw_rope, moving_rope
from shape_obs.configurations.centerline import Centerline
from shape_obs.detector import ShapeDetector
from shape_obs.utils.threads import one_thread

S = TypeVar("S")
Size = tuple[int, int]  # (width, height) in pixels
Stage = dict[str, Any]

WARM_UP: Final = 5  # frames and steps that are not counted
_SCENES: Final = 30  # played forwards and backwards
_EPISODE: Final = 50  # steps


def image_stages(size: Size, frames: int, clock: str, tick: Callable[[], Any] = lambda: None) -> list[Stage]:
    """Time detectors that find 20 points on a moving rope, about 8,000 of 640 x 480 pixels.

    Args:
        size: Of the images; the rope grows with the height.
        frames: Number of counted frames.
        clock: ``"wall"``, or ``"thread"`` for the processor time of this thread.
        tick: Called after each frame.

    Returns:
        A row for each stage: ``what`` was timed, the ``image`` size, ``median_ms``, ``p99_ms`` (the 99th percentile),
        and ``refused``, the number of frames without points.
    """
    in_mask, in_image, in_space, cold = (ShapeDetector([Centerline(n=20)], BLUE) for _ in range(4))

    def without_track(scene: Scene) -> bool:
        cold.reset()
        return cold.detect(scene.rgb, scene.depth, scene.camera).ok

    methods: dict[str, Callable[[Scene], bool]] = {
        "image to mask with OpenCV": lambda scene: bool(_largest_blue(scene.rgb).any()),
        "mask to points": lambda scene: in_mask.detect_mask(scene.mask).ok,
        "image to points": lambda scene: in_image.detect(scene.rgb).ok,
        "image and depth to 3D points": lambda scene: in_space.detect(scene.rgb, scene.depth, scene.camera).ok,
        "the same without a track": without_track,
    }
    rng = np.random.default_rng(0)
    scenes = [photograph(rng, _enlarged(rope, size), light=0.6) for rope in moving_rope(rng, 10.0, _SCENES, width=24.0)]
    scenes += scenes[-2:0:-1]

    def played() -> Iterator[Scene]:
        for i in range(WARM_UP + frames):
            scene = scenes[i % len(scenes)]
            for image in (scene.rgb, scene.mask, scene.depth):
                cv2.sumElems(image)  # reads it into the cache, so that it does not matter which stage is first
            yield scene

    return _timed(played(), methods, size, clock, tick)


def env_stages(name: str, size: Size, steps: int, clock: str, tick: Callable[[], Any] = lambda: None) -> list[Stage]:
    """Time the steps of a simulated environment with images, alone and inside ``ShapeObservation``.

    Args:
        name: ``"Cable"``, ``"Ring"``, ``"Cloth"`` or ``"Hanging"``.
        size: Of its images.
        steps: Number of counted steps; resets, after every 50 steps, are not timed.
        clock: See ``image_stages``.
        tick: Called after each step.
    """
    import gymnasium as gym

    from shape_obs.wrappers import ShapeObservation

    def make() -> gym.Env[Any, Any]:
        options: Any = {"camera": [*size], "disable_env_checker": True, "max_episode_steps": -1}
        return gym.make(f"shape_obs_envs:ShapeObs/{name}-v0", **options)

    with closing(make()) as bare, closing(ShapeObservation(make())) as wrapped:
        bare.action_space.seed(0)

        def actions() -> Iterator[Any]:
            for i in range(WARM_UP + steps):
                if i % _EPISODE == 0:
                    bare.reset(seed=i)
                    wrapped.reset(seed=i)
                yield bare.action_space.sample()

        methods: dict[str, Callable[[Any], bool]] = {
            f"step of {name}": lambda action: bool(bare.step(action)),
            f"step of {name} with ShapeObservation": lambda action: bool(wrapped.step(action)[4]["shape/ok"]),
        }
        return _timed(actions(), methods, size, clock, tick)


def _largest_blue(rgb: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
    """Return the largest blue object of an ``(H, W, 3)`` image, ``(H, W)``: range, opening, closing, components."""
    mask = cv2.inRange(cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV), np.array(BLUE.low), np.array(BLUE.high))
    square = np.ones((3, 3), np.uint8)
    mask = cv2.morphologyEx(cv2.morphologyEx(mask, cv2.MORPH_OPEN, square), cv2.MORPH_CLOSE, square)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    return np.asarray(labels == 1 + stats[1:, cv2.CC_STAT_AREA].argmax() if count > 1 else mask > 0)


def _enlarged(rope: Rope, size: Size) -> Rope:
    """Draw a rope of a 640 x 480 image in the middle of an image of another size, scaled by the height."""
    unit = size[1] / SIZE[0]
    middle = np.array([SIZE[1] - 1, SIZE[0] - 1]) / 2
    curve = (rope.curve - middle) * unit + (np.array(size) - 1) / 2
    return draw_rope(curve, rope.width * unit, size=(size[1], size[0]))


def _timed(
    frames: Iterable[S], methods: Mapping[str, Callable[[S], bool]], size: Size, clock: str, tick: Callable[[], Any]
) -> list[Stage]:
    """Run every method on every frame, on one thread; which one is first changes from frame to frame."""
    now, names = CLOCKS[clock], [*methods]
    turns: dict[str, list[tuple[float, bool]]] = {name: [] for name in names}
    with one_thread():
        for i, frame in enumerate(frames):
            for name in np.roll(names, -i).tolist():
                begin = now()
                ok = methods[name](frame)
                turns[name].append((1e3 * (now() - begin), ok))
            tick()
    stages = []
    for name, some in turns.items():
        times, ok = zip(*some[WARM_UP:], strict=True)
        median, p99 = np.percentile(times, [50, 99]).tolist()
        image = f"{size[0]} x {size[1]}"
        stages.append({"what": name, "image": image, "median_ms": median, "p99_ms": p99, "refused": ok.count(False)})
    return stages
