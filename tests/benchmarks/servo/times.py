"""Measure the time of each feature relative to the detector, on the same frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from shape_obs.detector import ShapeDetector
from shape_obs.features import Feature, FeatureContext, read_features
from shape_obs.geometry.topology import Grid
from shape_obs.wrappers import env_protocol
from tests.benchmarks import ServoEnv, Size
from tests.benchmarks.env_physics import held_actions, make_env
from tests.benchmarks.interleaved_timing import Method, Timing, median_ms, time_methods
from tests.benchmarks.servo.settings import FEATURES, LAYOUTS
from tests.benchmarks.tables import Row, at_most, grouped

WARM_UP: Final = 10  # frames that are not counted
_TARGET: Final = 10  # percent of the detector's time
_BURST: Final = 10  # frames in a turn
_DETECTOR: Final = "detector"


def closed_forms(env: ServoEnv) -> list[Feature]:
    """Return every feature of an environment's shape that is computed in closed form."""
    specs = [spec for some in FEATURES[env].values() for spec in some]
    specs += [{"kind": "points2d_normalized"}]
    if not isinstance(LAYOUTS[env], Grid):
        specs.append({"kind": "length", "frame": "base"})
    return read_features({str(spec): spec for spec in specs}.values())


def feature_times(
    env: ServoEnv,
    size: Size,
    frames: int,
    timing: Timing,
    renderer: str = "auto",
) -> list[Row]:
    """Return a row for each feature: median microseconds, and percent of the tracking detector's median time.

    Args:
        env: The environment, which is moved at random.
        size: (width, height) of the images, which have the noise of a D455.
        frames: Number of counted frames.
        timing: The clock, and the seed of the episode, its actions and its noise. Turns have ten frames each.
        renderer: The simulator's renderer.
    """
    looks, detector = _looks(env, size, frames + WARM_UP, timing.seed, renderer)

    features = {_label(feature): feature for feature in closed_forms(env)}
    methods: list[Method[Row]] = [
        Method(
            _DETECTOR, lambda look: detector.detect(look.rgb, look.depth, look.view.camera, anchors=look.view.anchors)
        ),
        *(Method(name, lambda look, each=each: each.compute(look.shape, look.view)) for name, each in features.items()),
    ]
    turns = time_methods(looks, methods, timing._replace(burst=_BURST), warm_up=WARM_UP)
    medians = {name: median_ms(some) for name, some in turns.items()}
    detection = medians.pop(_DETECTOR)
    return [
        Row(
            env=env,
            image=f"{size[0]}x{size[1]}",
            feature=name,
            values=len(features[name].compute(looks[-1].shape, looks[-1].view)),
            us=1e3 * ms,
            detector_ms=detection,
            percent=100 * ms / detection,
        )
        for name, ms in medians.items()
    ]


def targets(rows: Sequence[Row]) -> list[Row]:
    """Compare the slowest feature of each environment and image size with the target."""
    groups = grouped(rows, lambda row: (row.env, row.image))
    slowest = [max(some, key=lambda row: row.us) for some in groups.values()]
    return [
        at_most(f"{row.env} {row.image}: {row.feature}, of the detector's time", _TARGET, row.percent, " %")
        for row in slowest
    ]


def _looks(env: ServoEnv, size: Size, frames: int, seed: int, renderer: str) -> tuple[list[Row], ShapeDetector]:
    """Return the frames of one episode with their detected shapes, and the detector."""
    from shape_obs_envs.d455 import D455Noise

    simulated = D455Noise(make_env(env, {"camera": size, "renderer": renderer}))
    defaults = env_protocol.defaults(simulated)
    detector = ShapeDetector(defaults["shapes"], defaults["segmentation"], dt=defaults["dt"], on_invalid="interpolate")
    actions = held_actions(np.random.default_rng(seed), simulated.action_space.shape or (), frames, 8)
    observation, _ = simulated.reset(seed=seed)
    looks = []
    for action in actions:
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


def _label(feature: Feature) -> str:
    more = {name: value for name, value in feature.to_dict().items() if name in ("harmonics", "degree", "order")}
    more |= {"coefficients": feature.coefficients} if feature.kind == "bspline" else {}  # type: ignore[attr-defined]
    return " ".join([feature.kind, *map(str, list(more.values())[-1:])])
