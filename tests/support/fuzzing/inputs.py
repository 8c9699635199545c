"""Feed random, mostly degenerate inputs to the detector and the wrapper and count broken promises."""

from __future__ import annotations

import copy
import linecache
import pickle
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

import gymnasium as gym
import numpy as np
import numpy.typing as npt

import shape_obs
from fuzzing import random_inputs
from fuzzing.random_inputs import pick
from shape_obs.detector import ShapeDetector
from shape_obs.shape import Detection, Shape
from shape_obs.tracking.missing import ShapeLostError
from shape_obs.wrappers import ShapeObservation
from tests.detection_contract import broken_shape

#: What is counted, each asked to be zero.
PROMISES: Final = ("undeclared exceptions", "warnings", "broken contracts of a Shape", "bad observations")
_EXCEPTION, _WARNING, _CONTRACT, _OBSERVATION = PROMISES
_PACKAGE: Final = str(Path(shape_obs.__file__).parent)
_FRAMES: Final = (1, 1, 2, 4, 8)
_WRAPPED: Final = 0.2  # of the cases go through ``ShapeObservation``
_FEATURES: Final = (
    "points2d", "points2d_normalized", "points3d", "ok", "age", "valid", "sigma", "new", "centroid", "length",
    "orientation",
    "tangents", "turning_angles", "curvature", "fourier", "elliptic_fourier", "bezier", "bspline", "contour_moments",
    "region_moments",
)  # fmt: skip


class Failure(NamedTuple):
    """A promise that was broken.

    Args:
        promise: One of ``PROMISES``.
        case: Repeat it with ``run_case(seed, case)``.
        what: What happened, in words.
    """

    promise: str
    case: int
    what: str


def random_inputs_run(count: int, seed: int = 0) -> tuple[int, list[Failure]]:
    """Run random cases until ``count`` frames were seen; return how many were, and every broken promise."""
    inputs, case, failures = 0, 0, []
    while inputs < count:
        frames, broken = run_case(seed, case)
        inputs, case = inputs + frames, case + 1
        failures += broken
    return inputs, failures


def run_case(seed: int, case: int) -> tuple[int, list[Failure]]:
    """Run one detector or wrapper over a few random frames; return how many, and every broken promise."""
    rng = np.random.default_rng((seed, case))
    failures: list[Failure] = []
    run = _run_wrapper if rng.random() < _WRAPPED else _run_detector
    return run(rng, _Log(case, failures)), failures


class _Log(NamedTuple):
    case: int
    failures: list[Failure]

    def add(self, promise: str, what: str) -> None:
        self.failures.append(Failure(promise, self.case, what))

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Record warnings and undeclared exceptions; a declared exception ends the block silently."""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            # Declared: the scene is larger than the bounds of the features, or its depth is in a wrong unit.
            warnings.filterwarnings("ignore", message="features: .* values lie outside their bounds")
            warnings.filterwarnings(
                "ignore", message="stamps: |(depth|cloud): the object is|.*(Give metres|check the unit|if it is meant)"
            )
            try:
                yield
            except Exception as error:  # noqa: BLE001
                if not declared(error):  # every other kind is counted
                    self.add(_EXCEPTION, f"{type(error).__name__}: {error} ({_origin(error)})")
        for warning in caught:
            where = f"{Path(warning.filename).name}:{warning.lineno}"
            self.add(_WARNING, f"{warning.category.__name__}: {warning.message} ({where})")


def declared(error: Exception) -> bool:
    """Return whether an exception is one that the package raises on purpose: by a ``raise`` in its own code."""
    if isinstance(error, ShapeLostError):
        return True
    if not isinstance(error, (TypeError, ValueError)) or isinstance(error, np.linalg.LinAlgError):
        return False
    file, line = _last_line(error)
    return file.startswith(_PACKAGE) and linecache.getline(file, line).strip().startswith("raise ")


def _run_detector(rng: np.random.Generator, log: _Log) -> int:
    names = [f"shape{i}" for i in range(pick(rng, (1, 1, 1, 2)))]
    specs = [random_inputs.configuration(rng, name) for name in names]
    detector: Any = None
    with log.watching():
        detector = ShapeDetector(specs, **random_inputs.detector_options(rng))
    if detector is None:
        return 1
    frames, stamp = pick(rng, _FRAMES), 0.0
    scene, call = Scene(rng, specs), pick(rng, ("detect", "mask", "mask", "cloud", "any"))
    returned: list[tuple[Shape, bytes]] = []
    for _ in range(frames):
        if rng.random() < 0.1:
            scene = Scene(rng, specs)
        detector = _between_frames(rng, detector)
        at = random_inputs.stamp(rng, stamp)
        stamp = stamp if at is None else at
        with log.watching():
            detection, in_3d = _detect(rng, detector, scene, at, call)
            for shape, spec in zip(detection, detector.shapes, strict=True):
                in_2d = in_3d is not None
                for text in broken_shape(shape, spec.layout.size, in_2d=in_2d, in_3d=in_3d is not False):
                    log.add(_CONTRACT, f"{text}: {shape.name}, {spec.kind}")
                returned.append((shape, pickle.dumps(shape)))
    if any(pickle.dumps(shape) != before for shape, before in returned):
        log.add(_CONTRACT, "a later frame changed a shape")
    return frames


def _between_frames(rng: np.random.Generator, detector: ShapeDetector) -> ShapeDetector:
    """Return the detector after what its owner may do between two frames."""
    what = pick(rng, ("nothing",) * 9 + ("reset", "copy", "pickle"))
    if what == "reset":
        detector.reset()
    elif what == "copy":
        return copy.deepcopy(detector)
    elif what == "pickle":
        return pickle.loads(pickle.dumps(detector))
    return detector


def _detect(
    rng: np.random.Generator, detector: ShapeDetector, scene: Scene, stamp: float | None, call: str
) -> tuple[Detection, bool | None]:
    """Return what one random input gives, and whether points in space were due; None for a cloud."""
    scene.next_frame(rng)
    call = pick(rng, ("detect", "mask", "cloud")) if call == "any" else call
    known: dict[str, Any] = {"stamp": stamp, "anchors": scene.anchors}
    if call == "cloud":
        return detector.detect_cloud(scene.cloud, camera=scene.camera, **known), None
    if call == "mask":
        detection = detector.detect_mask(scene.mask, scene.depth, scene.camera, **known)
    else:
        detection = detector.detect(colour_image(rng, scene.mask), scene.depth, scene.camera, **known)
    return detection, scene.depth is not None and scene.camera is not None


def _run_wrapper(rng: np.random.Generator, log: _Log) -> int:
    spec, frames = random_inputs.configuration(rng, "shape"), pick(rng, _FRAMES)
    scene = Scene(rng, [spec])
    env = RandomImages(rng, scene)
    features = [pick(rng, _FEATURES) for _ in range(pick(rng, (1, 2, 3)))]
    options = random_inputs.detector_options(rng)
    for policy in ("on_missing", "on_invalid"):  # NaN is refused in observations
        options[policy] = "hold" if options[policy] == "nan" else options[policy]
    wrapped: Any = None
    with log.watching():
        wrapped = ShapeObservation(env, [spec], features=features, **options)
    if wrapped is None:
        return 1
    seen: list[tuple[npt.NDArray[Any], bytes]] = []
    for frame in range(frames):
        with log.watching():
            values, info = wrapped.reset() if not frame else wrapped.step(0)[::4]
            if not np.isfinite(values).all() or values not in wrapped.observation_space:
                log.add(_OBSERVATION, f"outside of its space: {features}")
            if not values.flags.writeable or any(np.shares_memory(values, before) for before, _ in seen):
                log.add(_OBSERVATION, f"not a writable copy: {features}")
            if not all(np.isfinite(value) for value in info.values() if isinstance(value, (bool, float, int))):
                log.add(_OBSERVATION, f"info {info}")
            seen.append((values, values.tobytes()))
    if any(values.tobytes() != before for values, before in seen):
        log.add(_OBSERVATION, "a later frame changed an observation")
    return frames


class Scene:
    """What several frames share: the size of the image, the camera, and an object that moves by a few pixels.

    It has what the configurations need, most of the time; else the detector refuses the frame.
    """

    def __init__(self, rng: np.random.Generator, specs: list[dict[str, Any]]) -> None:
        usual = rng.random() < 0.9
        anchors = [spec["anchor"] for spec in specs if spec["anchor"] is not None]
        self.needed = usual and any(spec["lift"] == "cloud" or spec["spacing"] == "m" for spec in specs)
        posed = usual and any(isinstance(anchor, str) or len(anchor) == 3 for anchor in anchors)
        self.size = random_inputs.image_size(rng)
        self.camera = random_inputs.camera(rng, self.size, needed=self.needed or posed, posed=posed)
        self.anchors = pick(rng, (None, {"hand": (3.0, 4.0)})) if not usual else {"hand": (0.1, 0.0, 0.5)}
        held = random_inputs.HELD[specs[0]["kind"]]
        self.cloud = random_inputs.cloud(rng, held)
        self.mask, self.depth = self._images(rng, held)

    def next_frame(self, rng: np.random.Generator) -> None:
        """Move the object, or replace it by anything."""
        if rng.random() < 0.5:
            self.mask = np.roll(self.mask, rng.integers(-2, 3, 2), axis=(0, 1))
            self.cloud = self.cloud + self.cloud.dtype.type(1e-3)
        else:
            self.mask, self.depth = self._images(rng)
            self.cloud = random_inputs.cloud(rng)

    def _images(self, rng: np.random.Generator, *kinds: tuple[str, ...]) -> tuple[Any, Any]:
        depth = random_inputs.depth(rng, self.size, needed=self.needed)
        return random_inputs.mask(rng, self.size, *kinds), depth


class RandomImages(gym.Env[Any, Any]):
    """An env without physics, whose images are those of a scene."""

    def __init__(self, rng: np.random.Generator, scene: Scene) -> None:
        self.rng, self.scene, self.camera_model = rng, scene, scene.camera
        self.anchors = scene.anchors or {}
        size = scene.size
        self.action_space = gym.spaces.Discrete(2)
        box = gym.spaces.Box
        images = {"rgb": box(0, 255, (*size, 3), np.uint8), "depth": box(-np.inf, np.inf, size, np.float32)}
        self.observation_space = gym.spaces.Dict(images)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Return new images."""
        return self._observation(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Return new images."""
        return self._observation(), 0.0, False, False, {}

    def _observation(self) -> dict[str, Any]:
        self.scene.next_frame(self.rng)
        depth = np.zeros(self.scene.size, np.float32) if self.scene.depth is None else self.scene.depth
        if depth.dtype == np.uint16:
            depth = depth * np.float32(1e-3)
        image = colour_image(self.rng, self.scene.mask)
        with np.errstate(over="ignore"):
            return {"rgb": image, "depth": depth.astype(np.float32)}


def colour_image(rng: np.random.Generator, mask: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    """Return a colour image: the mask on a dark table, or noise."""
    if rng.random() < 0.2:
        return rng.integers(0, 256, (*mask.shape, 3), dtype=np.uint8)
    return np.repeat(np.where(mask > 0, 230, 20).astype(np.uint8)[..., None], 3, axis=2)


def _last_line(error: BaseException) -> tuple[str, int]:
    trace = error.__traceback__
    assert trace is not None
    while trace.tb_next is not None:
        trace = trace.tb_next
    return trace.tb_frame.f_code.co_filename, trace.tb_lineno


def _origin(error: BaseException) -> str:
    file, line = _last_line(error)
    return f"{Path(file).name}:{line}"
