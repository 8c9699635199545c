"""Shape servoing: bring simulated shapes to goals, with laws that start without any knowledge of the object."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import replace
from itertools import product
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from shape_obs.detector import ShapeDetector
from shape_obs.servo import ShapeServo
from shape_obs.shape import Detection, Shape
from shape_obs.wrappers import ShapeGoal, ShapeObservation
from tests.benchmarks.claim import Claim, Effort, Limit
from tests.benchmarks.envs import make_env
from tests.benchmarks.tables import Column, Row, median, of, percent, total

DIFFICULTIES: Final = ("near", "middle", "far")
STEPS: Final = 200
REACHED: Final = 10.0  # millimetres
_LAST: Final = 5  # steps over which the final error is the mean
_STREAM: Final = 0x1057  # separates the lost points from everything that the environment draws from the same seed


# Features without position are joined by the centroid, those without rotation by the orientation.
_POINTS: Final = ("points3d", "points2d", "tangents, centroid")
_LINES: Final = ("curvature, orientation, centroid", "turning_angles, orientation, centroid")
#: The sets of features of each environment; moments, angles and curvatures are those of a plane.
FEATURES: Final[Mapping[str, tuple[str, ...]]] = {
    "Cable": (*_POINTS, "fourier", "bezier", "bspline", *_LINES, "contour_moments"),
    "Ring": (*_POINTS, *_LINES, "elliptic_fourier", "bspline", "contour_moments, region_moments"),
    "Cloth": (*_POINTS, "fourier", "bezier", "bspline", "region_moments"),
}
_OPTIONS: Final[Mapping[str, Mapping[str, int]]] = {
    "fourier": {"harmonics": 4}, "elliptic_fourier": {"harmonics": 6}, "bezier": {"degree": 6},
    "bspline": {"coefficients": 8}, "contour_moments": {"order": 3}, "region_moments": {"order": 3},
}  # fmt: skip


def features(env: str, kinds: str) -> list[dict[str, Any]]:
    """Return the specs of features in the base frame."""
    own = {**_OPTIONS, "bspline": {"coefficients": 5}} if env == "Cloth" else _OPTIONS
    base = {kind: {} if kind == "points2d" else {"frame": "base"} for kind in kinds.split(", ")}
    return [{"kind": kind, **frame, **own.get(kind, {})} for kind, frame in base.items()]


class Setting(NamedTuple):
    """A combination of an environment, features, a law and a source of points.

    Args:
        env: The environment.
        difficulty: Distance of the goals from the start.
        source: ``"camera"``: points detected in the images of a D455; ``"truth"``: the points of the simulator.
        size: Image size such as ``"160x120"``.
        features: A name of ``FEATURES``; the truth has only ``"points3d"``.
        law: A name of ``shape_obs.servo.LAWS``.
        lost: Share of the points that are lost, drawn again in every frame, and interpolated from the others.
        renderer: The simulator's renderer.
        view: Where the camera of the hanging rope stands; None for the environment's default.
        rope: Which of several ropes is brought to its goal; None for the environment's default.
    """

    env: str
    difficulty: str
    source: Literal["camera", "truth"] = "camera"
    size: str = "160x120"
    features: str = "points3d"
    law: str = "rls"
    lost: float = 0.0
    renderer: str = "auto"
    view: str | None = None
    rope: int | None = None


class LosingDetector(ShapeDetector):
    """A detector that loses a share of the detected points and interpolates them from the others.

    Attributes:
        lost: The share.
        rng: Draws the lost points.
    """

    lost, rng = 0.0, np.random.default_rng(_STREAM)

    def detect(self, *args: Any, **options: Any) -> Detection:
        """Detect the shapes and lose points."""
        detection = super().detect(*args, **options)
        return replace(detection, shapes=tuple(map(self._without, detection.shapes)))

    def _without(self, shape: Shape) -> Shape:
        """Return a shape in which some points are neither visible nor valid; a held shape is unchanged."""
        known = self.rng.random(len(shape)) >= self.lost
        left = shape.valid & known
        if shape.reason or not left.any():
            return shape
        in_space = None if shape.points3d is None else shape.layout.interpolate(shape.points3d, known)
        in_image = shape.layout.interpolate(shape.pixels, known)
        return replace(shape, points2d=in_image, points3d=in_space, visible=shape.visible & known, valid=left)


class World:
    """An environment of a setting, with goals in its features; equal seeds give equal episodes in all worlds.

    Attributes:
        env: The env; it never ends an episode by itself. ``info`` has ``truth/points``, (N, 3) metres, base frame, and
            ``truth/mean_error``, the mean distance between them and those of the goal.
        observing: The wrapper that detects the shape; None for the simulator's points.
        coordinates: The values of an action that move the gripper of the named rope, and no other; None for all.
    """

    def __init__(self, setting: Setting) -> None:
        from shape_obs_envs.d455 import D455Noise

        is_true = setting.source == "truth"
        size = [int(pixels) for pixels in setting.size.split("x")]
        options = {"camera": size, "renderer": setting.renderer, "difficulty": setting.difficulty}
        options |= {name: value for name in ("view", "rope") if (value := getattr(setting, name)) is not None}
        self.env = make_env(setting.env, {**options, "render_observation": not is_true})
        rope, moved = getattr(self.env.unwrapped, "rope", None), self.env.get_wrapper_attr("STEP").size
        self.coordinates = None if rope is None else range(rope * moved, (rope + 1) * moved)
        self.observing: ShapeObservation | None = None
        if not is_true:
            self.observing = ShapeObservation(D455Noise(self.env))
            if setting.lost:
                self.observing.detector = LosingDetector(**self.observing.detector.config.to_dict())
                self.observing.detector.lost = setting.lost
            # A reward needs a threshold, but the reward is not used here.
            chosen = features(setting.env, setting.features)
            self.env = ShapeGoal(self.observing, features=chosen, threshold=0.01)


def play(world: World, law: str, seed: int, steps: int = STEPS) -> Row:
    """Bring the shape to the goal of a seed.

    Returns:
        Errors are mean distances of the true points from the true goal's, in millimetres: ``start_mm`` before the first
        step, ``final_mm`` the mean of the last five steps. ``success``: whether ``final_mm`` is below 10; ``steps``:
        the first step after which the error stays below 10, or None; ``seen_mm``: median over the frames of the mean
        distance of the detected points from the true ones; ``held``: observations without an action.
    """
    servo = ShapeServo(law, int(np.prod(world.env.action_space.shape or ())), coordinates=world.coordinates)
    if world.observing is not None:
        servo.attach(world.env)
        if isinstance(world.observing.detector, LosingDetector):
            world.observing.detector.rng = np.random.default_rng((_STREAM, seed))
    observation, info = world.env.reset(seed=seed)
    errors, off = [1e3 * info["truth/mean_error"]], list[float]()
    for _ in range(steps):
        if world.observing is not None and (detection := world.observing.detection) is not None:
            shape, camera = detection.shapes[0], world.observing.contexts[0].camera
            if shape.points3d is not None and camera is not None:
                away = camera.to_base(shape.points3d) - info["truth/points"]
                off.append(1e3 * float(np.linalg.norm(away, axis=1).mean()))
        observation, _, _, _, info = world.env.step(servo.act(observation))
        errors.append(1e3 * info["truth/mean_error"])
    final, above = float(np.mean(errors[-_LAST:])), np.flatnonzero(np.asarray(errors) >= REACHED)
    settled = int(above[-1]) + 1 if len(above) else 0
    success = final < REACHED
    row = Row(seed=seed, success=success, start_mm=errors[0], final_mm=final, seen_mm=median(off), held=servo.held)
    return Row(row, steps=settled if success and settled < len(errors) else None)


def episodes(scene: tuple[Setting, range]) -> Iterator[Row]:
    """Play one episode for each seed."""
    setting, seeds = scene
    world = World(setting)
    with closing(world.env):
        for seed in seeds:
            yield Row(setting._asdict(), **play(world, setting.law, seed))


COLUMNS: Final[dict[str, Column]] = {
    "goals": len,
    "reached [%]": percent("success"),
    "final, median [mm]": of(median, "final_mm"),
    "steps, median": of(median, "steps"),
    "start, median [mm]": of(median, "start_mm"),
    "points off, median [mm]": of(median, "seen_mm"),
    "held": total("held"),
}
_NOISE: Final = "a cable stalls at a bend that would have to be turned over"
_REACHED: Final = tuple(
    Limit("reached [%]", at_least=least, unit="%", where={"env": env, "source": "camera", "difficulty": how}, known=why)
    for env, shares, why in (("Cable", (95, 85, 70), _NOISE), ("Ring", (95, 90, 88), ""), ("Hanging", (95, 90, 80), ""))
    for how, least in zip(DIFFICULTIES, shares, strict=True)
)


def _study(name: str, what: str, full: int, by: tuple[str, ...], settings: list[Setting], *limits: Limit) -> Claim:
    """Return the claim about some settings on the same goals, ``full`` of each, or some settings on one goal."""

    def scenes(effort: Effort) -> Iterator[tuple[Setting, range]]:
        every = max(round(1 / (full * effort.share)), 1) | 1  # odd, for all difficulties
        return ((each._replace(renderer=effort.renderer), effort.seeds(full)) for each in settings[::every])

    return Claim(f"servo.{name}", what, scenes, episodes, by, COLUMNS, limits=limits, needs=("mujoco",))


CLAIMS: Final = (
    _study("goals", "Goals reached from the camera's and from the true points, with points3d and rls.", 67,
           ("env", "source", "difficulty"),
           [Setting(env, how, source) for env in ("Cable", "Ring", "Cloth", "Hanging") for source in ("camera", "truth")
            for how in DIFFICULTIES], *_REACHED),
    _study("sizes", "Goals reached from the camera at 640 x 480, and with the hanging rope seen from above.", 50,
           ("env", "size", "view", "difficulty"),
           [*(Setting(env, how, size="640x480") for env in ("Cable", "Ring", "Cloth") for how in DIFFICULTIES),
            *(Setting("Hanging", how, view="above") for how in DIFFICULTIES)],
           Limit("reached [%]", at_least=85, unit="%", where={"env": ("Cable", "Ring", "Hanging")}, sampled=60)),
    _study("features", "Features and laws on the same goals, from the camera.", 4, ("env", "features", "law"),
           [Setting(env, how, features=each, law=law)
            for env, laws in (("Cable", ("rls", "mfac", "broyden", "kalman", "mfac-law")), ("Ring", ("rls", "mfac")),
                              ("Cloth", ("rls",)))
            for each, law, how in product(FEATURES[env], laws, DIFFICULTIES)],
           Limit("reached [%]", at_least=75, unit="%",
                 where={"env": "Cable", "features": ("points3d", "fourier", "bspline"), "law": ("rls", "mfac")})),
    _study("lost", "The cable with 20 % of the points lost in every frame.", 50, ("features", "lost", "difficulty"),
           [Setting("Cable", how, features=each, lost=lost)
            for each, lost, how in product(("points3d", "bspline"), (0.0, 0.2), DIFFICULTIES)],
           Limit("reached [%]", at_least=80, unit="%", where={"features": "bspline"})),
    _study("cables", "One rope of three in Cables-v0, at 640 x 480 and from the truth.", 50, ("source", "law", "rope"),
           [Setting("Cables", "middle", source, "640x480", law=law, rope=rope)
            for source, law, rope in product(("camera", "truth"), ("broyden", "rls"), (0, 1))],
           Limit("reached [%]", at_least=90, unit="%", where={"law": "broyden"})),
)  # fmt: skip
