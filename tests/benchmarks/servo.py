"""Shape servoing: bring simulated shapes to goals, with laws that start without any knowledge of the object."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any, Final, Literal, NamedTuple

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from shape_obs.configurations.base import Configuration
from shape_obs.detector import ShapeDetector
from shape_obs.features import Feature, FeatureContext, FeatureVector, read_features
from shape_obs.servo import ShapeServo, geometric_weights, make_law
from shape_obs.shape import Detection, Shape
from shape_obs.wrappers import ShapeGoal, ShapeObservation, env_protocol, record_goal
from shape_obs.wrappers.goals import shape_at
from tests.benchmarks.claim import Claim, Effort, Limit
from tests.benchmarks.envs import DIFFICULTIES, held_actions, make_env
from tests.benchmarks.tables import Column, Row, median, of, percent, worst
from tests.benchmarks.timing import Method, median_ms, time_methods

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Specs = tuple[dict[str, Any], ...]
STEPS: Final = 200
REACHED: Final = 10.0  # millimetres
_LAST: Final = 5  # steps over which the final error is the mean
_STREAM: Final = 0x1057  # separates the lost points from everything that the environment draws from the same seed
_SETTLING: Final = 20  # steps at rest before a goal is recorded


def _base(kind: str, **more: Any) -> dict[str, Any]:
    return {"kind": kind, "frame": "base", **more}


# Features without position are joined by the centroid, those without rotation by the orientation.
_PLACE: Final = (_base("orientation"), _base("centroid"))
_EVERYWHERE: Final[Mapping[str, Specs]] = {
    "points3d": (_base("points3d"),),
    "points2d": ({"kind": "points2d"},),
    "tangents": (_base("tangents"), _base("centroid")),
}
_LINES: Final[Mapping[str, Specs]] = {
    "curvature": (_base("curvature"), *_PLACE),
    "turning_angles": (_base("turning_angles"), *_PLACE),
}
_ROPE: Final[Mapping[str, Specs]] = {
    **_EVERYWHERE,
    "fourier": (_base("fourier", harmonics=4),),
    "bezier": (_base("bezier", degree=6),),
    "bspline": (_base("bspline", coefficients=8),),
}
_MOMENTS: Final = _base("contour_moments", order=3), _base("region_moments", order=3)
#: The sets of features of each environment.
FEATURES: Final[Mapping[str, Mapping[str, Specs]]] = {
    "Cable": {**_ROPE, **_LINES, "moments": _MOMENTS[:1]},
    "Ring": {
        **_EVERYWHERE,
        **_LINES,
        "fourier": (_base("elliptic_fourier", harmonics=6),),
        "bspline": (_base("bspline", coefficients=8),),
        "moments": _MOMENTS,
    },
    "Cloth": {**_ROPE, "bspline": (_base("bspline", coefficients=5),), "moments": _MOMENTS[1:]},
    "Cables": {**_ROPE, **_LINES},
    "Hanging": _ROPE,  # moments, angles and curvatures are those of a plane
}


class Setting(NamedTuple):
    """A combination of an environment, features, a law and a source of points.

    Args:
        env: The environment.
        difficulty: Distance of the goals from the start.
        source: ``"camera"``: points detected in the images of a D455; ``"truth"``: the points of the simulator;
            ``"taught"``: the camera for the points and also for the goal, as a goal is recorded on a real table.
        size: Image size such as ``"160x120"``; features in pixels need it for the truth as well.
        features: A name of ``FEATURES``.
        law: A name of ``shape_obs.servo.LAWS``.
        lost: Share of the points that are lost, drawn again in every frame, and interpolated from the others.
        blackout: The step after which black frames begin, and their number.
        renderer: The simulator's renderer.
        view: Where the camera of the hanging rope stands; None for the environment's default.
        rope: Which of several ropes is brought to its goal; None for the environment's default.
    """

    env: str
    difficulty: str
    source: Literal["camera", "truth", "taught"] = "camera"
    size: str = "160x120"
    features: str = "points3d"
    law: str = "rls"
    lost: float = 0.0
    blackout: tuple[int, int] = (0, 0)
    renderer: str = "auto"
    view: str | None = None
    rope: int | None = None


class Disturbed(gym.ObservationWrapper[Any, Any, Any]):
    """Black out frames of an RGB-D env, and draw the lost points, equal in all episodes of one seed."""

    def __init__(self, env: gym.Env[Any, Any], setting: Setting) -> None:
        super().__init__(env)
        self._lost, self._blackout = setting.lost, setting.blackout
        self._rng, self._step = np.random.default_rng(_STREAM), 0
        self.dark = False

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the env; a seed also seeds the lost points."""
        if seed is not None:
            self._rng = np.random.default_rng((_STREAM, seed))
        self._step = -1
        return super().reset(seed=seed, options=options)

    def observation(self, observation: Any) -> Any:
        """Return the observation, or black images, and advance the disturbance by one frame."""
        self._step += 1
        first, count = self._blackout
        self.dark = first <= self._step < first + count
        if not self.dark:
            return observation
        return {**observation, **{key: np.zeros_like(observation[key]) for key in ("rgb", "depth")}}

    def lost(self, count: int) -> Mask:
        """Draw the points that are lost in this frame, (count,)."""
        return self._rng.random(count) < self._lost


class LosingDetector(ShapeDetector):
    """A detector that loses detected points and interpolates them from the others."""

    def __init__(self, lost: Callable[[int], Mask], **config: Any) -> None:
        self._lost = lost
        super().__init__(**config)

    def detect(self, *args: Any, **options: Any) -> Detection:
        """Detect the shapes and lose points."""
        detection = super().detect(*args, **options)
        return replace(detection, shapes=tuple(without(shape, self._lost(len(shape))) for shape in detection))


def without(shape: Shape, lost: Mask) -> Shape:
    """Return a shape in which some points are interpolated and neither visible nor valid; a held shape is unchanged."""
    left, known = shape.valid & ~lost, ~lost
    if shape.reason or not left.any():
        return shape
    in_space = None if shape.points3d is None else shape.layout.interpolate(shape.points3d, known)
    in_image = shape.layout.interpolate(shape.pixels, known)
    return replace(shape, points2d=in_image, points3d=in_space, visible=shape.visible & known, valid=left)


class TrueDetector(ShapeDetector):
    """Return the simulator's points as the detected shape, for any images."""

    def __init__(self, truth: Callable[[], Array], **config: Any) -> None:
        self._truth = truth
        super().__init__(**config)

    def detect(self, *args: Any, stamp: float = 0.0, **options: Any) -> Detection:
        """Return the points; ``args`` are the images and the camera."""
        camera, spec = args[2], self.shapes[0]
        return Detection((shape_at(camera.from_base(self._truth()), spec, camera.intrinsics),), stamp)


class Unseen(gym.ObservationWrapper[Any, Any, Any]):
    """Add black images of a (width, height) to the observation of an environment that does not render."""

    def __init__(self, env: gym.Env[Any, Any], size: tuple[int, int]) -> None:
        super().__init__(env)
        width, height = size
        self._images = {"rgb": np.zeros((height, width, 3), np.uint8), "depth": np.zeros((height, width), np.uint16)}
        boxes = {key: gym.spaces.Box(0, 255, image.shape, image.dtype.type) for key, image in self._images.items()}
        assert isinstance(env.observation_space, gym.spaces.Dict)
        self.observation_space = gym.spaces.Dict({**env.observation_space.spaces, **boxes})

    def observation(self, observation: Any) -> Any:
        """Return the observation with the images."""
        return {**observation, **self._images}


class Witness(gym.Wrapper[Any, Any, Any, Any]):
    """Add the true goal to ``info``, which no policy reads."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the env."""
        observation, info = self.env.reset(seed=seed, options=options)
        info["truth/goal"] = np.asarray(observation["desired_goal"]).reshape(-1, 3).copy()
        return observation, info


class Taught(gym.Wrapper[Any, Any, Any, Any]):
    """Play the goal's own motion before each episode, and use the final image of it as the goal."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Play, record the goal, and reset to the same start."""
        self.env.reset(seed=seed, options=options)
        motion = self.get_wrapper_attr("goal_actions")
        for action in [*motion, *np.zeros((_SETTLING, motion.shape[1]), np.float32)]:
            self.env.step(action)
        seen = record_goal(self.env, frame="base", unmeasured=True)
        return self.env.reset(seed=seed, options={**(options or {}), "goal": seen})


class World:
    """An environment of a setting, with goals in its features; equal seeds give equal episodes in all worlds.

    Attributes:
        env: The env; it never ends an episode by itself. ``info`` has ``truth/points`` and ``truth/goal``, (N, 3)
            metres, base frame, and ``truth/mean_error``, the mean distance between them.
        features: The features of the goals.
        spec: The configuration of the shape.
        coordinates: The values of an action that move the gripper of the named rope, and no other; None for all.
    """

    def __init__(self, setting: Setting) -> None:
        from shape_obs_envs.d455 import D455Noise

        is_true = setting.source == "truth"
        width, _, height = setting.size.partition("x")
        pixels = int(width), int(height)
        options = {"camera": pixels, "renderer": setting.renderer, "difficulty": setting.difficulty}
        options |= {name: value for name in ("view", "rope") if (value := getattr(setting, name)) is not None}
        env = Witness(make_env(setting.env, {**options, "render_observation": not is_true}))
        self.disturbed = Disturbed(Unseen(env, pixels) if is_true else D455Noise(env), setting)
        # The simulator's points are those of the shape with the goal, which other slots need not be known for.
        first = Configuration.from_dict(env_protocol.defaults(env)["shapes"][0]).slots()[0]
        self.observing = ShapeObservation(self.disturbed, [first] if is_true else None)
        config = self.observing.detector.config.to_dict()
        if is_true:
            self.observing.detector = TrueDetector(env.get_wrapper_attr("truth"), **config)
        elif setting.lost:
            self.observing.detector = LosingDetector(self.disturbed.lost, **config)
        rope, moved = getattr(env.unwrapped, "rope", None), env.get_wrapper_attr("STEP").size
        self.coordinates = None if rope is None else range(rope * moved, (rope + 1) * moved)
        self.features = tuple(read_features(FEATURES[setting.env][setting.features]))
        self.spec = self.observing.detector.shapes[0]
        # A reward needs a threshold, but the reward is not used here.
        self.env: gym.Env[Any, Any] = ShapeGoal(self.observing, features=self.features, threshold=0.01)
        if setting.source == "taught":
            self.env = Taught(self.env)

    @property
    def seen(self) -> Shape:
        """The shape of the last observation."""
        assert self.observing.detection is not None
        return self.observing.detection.shapes[0]

    @property
    def view(self) -> FeatureContext:
        """The context of its features."""
        return self.observing.contexts[0]


def play(world: World, law: str, seed: int, steps: int = STEPS) -> Row:
    """Bring the shape to the goal of a seed.

    Returns:
        Errors are mean distances of the true points from the true goal's, in millimetres: ``start_mm`` before the first
        step, ``final_mm`` the mean of the last five steps. ``success``: whether ``final_mm`` is below 10; ``steps``:
        the first step after which the error stays below 10 mm, or None; ``seen_mm``: median over the frames of the mean
        distance of the detected points from the true ones; ``dark_action``: the largest coordinate of an action that
        was chosen in a black frame; ``held``: observations without an action; ``broken``: whether it broke off.
    """
    space, vector = world.env.action_space, FeatureVector(world.features, [world.spec], world.view)
    weights = geometric_weights(world.features, world.spec.layout, world.view)
    how: Any = "noise" if weights is None else weights
    servo = ShapeServo(
        make_law(law),
        actions=int(np.prod(space.shape or ())),
        seen=lambda: world.seen,
        measured=lambda: vector.measured([world.seen]),
        weights=how,
        coordinates=world.coordinates,
    )
    observation, info = world.env.reset(seed=seed)
    errors, points, off, dark = [1e3 * info["truth/mean_error"]], info["truth/points"], list[float](), 0.0
    for _ in range(steps):
        seen, camera = world.seen.points3d, world.view.camera
        assert camera is not None
        if seen is not None:
            off.append(1e3 * float(np.linalg.norm(camera.to_base(seen) - points, axis=1).mean()))
        action, black = servo.act(observation), world.disturbed.dark
        dark = max(dark, float(np.abs(action).max())) if black else dark
        observation, _, _, _, info = world.env.step(action)
        points = info["truth/points"]
        errors.append(1e3 * info["truth/mean_error"])
    final = float(np.mean(errors[-_LAST:]))
    result = {"success": final < REACHED, "steps": settled(errors), "seen_mm": median(off), "dark_action": dark}
    return Row(result, seed=seed, start_mm=errors[0], final_mm=final, held=servo.held, broken=False)


def settled(errors: list[float]) -> int | None:
    """Return the first step after which errors ``(T+1,)``, in millimetres, stay below 10, or None."""
    above = np.flatnonzero(np.asarray(errors) >= REACHED)
    first = int(above[-1]) + 1 if len(above) else 0
    return first if first < len(errors) else None


def episodes(scene: tuple[Setting, range]) -> Iterator[Row]:
    """Play one episode for each seed; an episode that breaks off reaches nothing."""
    setting, seeds = scene
    world = World(setting)
    try:
        for seed in seeds:
            try:
                row = play(world, setting.law, seed)
            except (ValueError, RuntimeError, ArithmeticError):
                row = Row(seed=seed, success=False, dark_action=0.0, held=0, broken=True)
                row.update(dict.fromkeys(("steps", "seen_mm", "final_mm", "start_mm")))
            # A step counts only where the goal was reached.
            yield Row({**row, **setting._asdict(), "steps": row.steps if row.success else None})
    finally:
        world.env.close()


def _looks(env: str, frames: int, renderer: str) -> tuple[list[Row], ShapeDetector]:
    """Return the frames of one episode with their detected shapes, and the detector."""
    from shape_obs_envs.d455 import D455Noise

    size = 160, 120
    simulated = D455Noise(make_env(env, {"camera": size, "renderer": renderer}))
    defaults = env_protocol.defaults(simulated)
    detector = ShapeDetector(defaults["shapes"], defaults["segmentation"], dt=defaults["dt"], on_invalid="interpolate")
    observation, _ = simulated.reset(seed=0)
    looks = []
    for action in held_actions(np.random.default_rng(0), simulated.action_space.shape or (), frames, 8):
        named, camera = dict(env_protocol.anchors(simulated)), env_protocol.camera_model(simulated)
        point = env_protocol.base_point(detector.shapes[0], named)
        view = FeatureContext(*size, camera, defaults["workspace"], anchor=point, anchors=named)
        rgb, depth = observation["rgb"], observation["depth"]
        shape = detector.detect(rgb, depth, camera, anchors=named).shapes[0]
        looks.append(Row(rgb=rgb, depth=depth, view=view, shape=shape))
        observation = simulated.step(action)[0]
    simulated.close()
    detector.reset()
    return looks, detector


def feature_times(scene: tuple[str, int, str]) -> Iterator[Row]:
    """Time every feature of an environment's shape that has a closed form, and the detector, in turns on one thread."""
    env, frames, renderer = scene
    looks, detector = _looks(env, frames + 10, renderer)
    specs = {str(spec): spec for some in FEATURES[env].values() for spec in some}
    features = {str(each.to_dict()): each for each in read_features(specs.values())}

    def compute(feature: Feature, look: Row) -> object:
        return feature.compute(look.shape, look.view)

    def detect(look: Row) -> object:
        return detector.detect(look.rgb, look.depth, look.view.camera, anchors=look.view.anchors)

    methods = [Method("detector", detect), *(Method(name, partial(compute, each)) for name, each in features.items())]
    times = {name: median_ms(some) for name, some in time_methods(looks, methods, warm_up=10, burst=10).items()}
    detection = times.pop("detector")
    for name, ms in times.items():
        yield Row(env=env, feature=features[name].kind, us=1e3 * ms, percent=100 * ms / detection)


COLUMNS: Final[dict[str, Column]] = {
    "goals": len,
    "reached [%]": percent("success"),
    "final, median [mm]": of(median, "final_mm"),
    "steps, median": of(median, "steps"),
    "start, median [mm]": of(median, "start_mm"),
    "points off, median [mm]": of(median, "seen_mm"),
    "held": lambda rows: sum(row.held for row in rows),
    "largest action in the dark": of(worst, "dark_action"),
    "broke off": lambda rows: sum(row.broken for row in rows),
}
_NOISE: Final = "a cable stalls at a bend that would have to be turned over"
_REACHED: Final = tuple(
    Limit("reached [%]", at_least=least, unit="%", where={"env": env, "source": "camera", "difficulty": how}, known=why)
    for env, shares, why in (("Cable", (95, 85, 70), _NOISE), ("Ring", (95, 90, 88), ""), ("Hanging", (95, 90, 80), ""))
    for how, least in zip(DIFFICULTIES, shares, strict=True)
)


def _study(name: str, what: str, full: int, by: tuple[str, ...], settings: list[Setting], *limits: Limit) -> Claim:
    """Return the claim about some settings on the same goals, ``full`` of each at the full share."""

    def scenes(effort: Effort) -> Iterator[tuple[Setting, range]]:
        return ((each._replace(renderer=effort.renderer), effort.seeds(full)) for each in settings)

    whole = (*limits, Limit("broke off", at_most=0))
    return Claim(f"servo.{name}", what, scenes, episodes, by, COLUMNS, limits=whole, needs=("mujoco",))


CLAIMS: Final = (
    _study("goals", "Goals reached from the camera's and from the true points, with points3d and rls.", 67,
           ("env", "source", "difficulty"),
           [Setting(env, how, source) for env in ("Cable", "Ring", "Cloth", "Hanging") for source in ("camera", "truth")
            for how in DIFFICULTIES], *_REACHED),
    _study("sizes", "Goals reached from the camera at 640 x 480, and with the hanging rope seen from above.", 50,
           ("env", "size", "view", "difficulty"),
           [*(Setting(env, how, size="640x480") for env in ("Cable", "Ring", "Cloth") for how in DIFFICULTIES),
            *(Setting("Hanging", how, view="above") for how in DIFFICULTIES)],
           Limit("reached [%]", at_least=85, unit="%", where={"env": ("Cable", "Ring", "Hanging")})),
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
    _study("dark", "The cable with ten black frames from step 60 on.", 20, ("features", "difficulty"),
           [Setting("Cable", "middle", features=each, blackout=(60, 10)) for each in ("points3d", "bspline")],
           Limit("largest action in the dark", at_most=0), Limit("reached [%]", at_least=85, unit="%")),
    _study("taught", "The cloth, with goals that the camera recorded.", 12, ("features", "difficulty"),
           [Setting("Cloth", how, source="taught") for how in DIFFICULTIES]),
    _study("cables", "One rope of three in Cables-v0, at 640 x 480 and from the truth.", 50, ("source", "law", "rope"),
           [Setting("Cables", "middle", source, "640x480", law=law, rope=rope)
            for source, law, rope in product(("camera", "truth"), ("broyden", "rls"), (0, 1))],
           Limit("reached [%]", at_least=90, unit="%", where={"law": "broyden"})),
    Claim(
        "servo.times", "The time of every feature with a closed form, relative to the detector's.",
        lambda effort: ((env, effort.count(60), effort.renderer) for env in ("Cable", "Ring", "Cloth")), feature_times,
        ("env", "feature"), {"median [us]": of(worst, "us"), "of the detector [%]": of(worst, "percent")},
        limits=(Limit("of the detector [%]", at_most=10, unit="%"),),
        needs=("mujoco",),
    ),
)  # fmt: skip
