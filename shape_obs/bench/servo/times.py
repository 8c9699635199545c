"""How long each feature takes beside the NumPy detector, on the same frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from shape_obs.bench.env_speed import Env, held_actions, make_env
from shape_obs.bench.interleaved_timing import Clock, Entrant, turns
from shape_obs.bench.servo.settings import FEATURES, LAYOUTS
from shape_obs.bench.tables import at_most
from shape_obs.detector import ShapeDetector
from shape_obs.features import Feature, View, read_features
from shape_obs.geometry.topology import Grid
from shape_obs.shape import Shape
from shape_obs.utils.threads import one_thread
from shape_obs.wrappers import env_protocol

Row = dict[str, Any]

WARM_UP: Final = 10  # frames that are not counted
_ASKED: Final = 10  # percent
_BURST: Final = 10  # frames in a turn
_DETECTOR: Final = "detector"


class _Look(NamedTuple):
    """One frame, and what was found in it."""

    rgb: Any
    depth: Any
    view: View
    shape: Shape


def closed_forms(env: Env) -> list[Feature]:
    """Every feature that is computed in closed form and that there is of an environment's shape."""
    specs = [spec for some in FEATURES[env].values() for spec in some]
    specs += [{"kind": "points2d_normalized"}]
    if not isinstance(LAYOUTS[env], Grid):
        specs.append({"kind": "length", "frame": "base"})
    return read_features({str(spec): spec for spec in specs}.values())


def feature_times(
    env: Env,
    size: tuple[int, int],
    frames: int = 60,
    *,
    seed: int = 0,
    renderer: str = "auto",
    clock: Clock = "wall",
    tick: Callable[[int], object] = lambda done: None,
) -> list[Row]:
    """A row for each feature: median microseconds, and the share of the tracking detector's median, percent.

    Args:
        env: The environment that is moved at random.
        size: (width, height) of the images, which have a D455's noise.
        frames: How many are counted.
        seed: Of the episode, its actions and its noise.
        renderer: The simulator's camera.
        clock: Counts the time that passes, or the processor time of the one thread.
        tick: Called with how many more frames are done.
    """
    looks, detector = _looks(env, size, frames + WARM_UP, seed, renderer)

    def detect(look: _Look) -> object:
        return detector.detect(look.rgb, look.depth, look.view.camera, anchors=look.view.anchors)

    def computing(feature: Feature) -> Callable[[_Look], object]:
        return lambda look: feature.compute(look.shape, look.view)

    features = {_label(feature): feature for feature in closed_forms(env)}
    entrants = [Entrant(_DETECTOR, detect), *(Entrant(name, computing(each)) for name, each in features.items())]
    taken: dict[str, list[float]] = {entrant.name: [] for entrant in entrants}
    with one_thread():
        for turn in turns(looks, entrants, clock, burst=_BURST):
            if turn.frame >= WARM_UP:
                taken[turn.name].append(turn.milliseconds)
            if turn.name == _DETECTOR:
                tick(1)
    detection = float(np.median(taken.pop(_DETECTOR)))
    found = {name: float(np.median(each)) for name, each in taken.items()}
    return [
        {
            "env": env,
            "image": f"{size[0]}x{size[1]}",
            "feature": name,
            "values": len(features[name].compute(looks[-1].shape, looks[-1].view)),
            "us": 1e3 * ms,
            "detector_ms": detection,
            "percent": 100 * ms / detection,
        }
        for name, ms in found.items()
    ]


def asked_rows(rows: Sequence[Row]) -> list[Row]:
    """What is asked of features, and what the slowest of each environment and size takes."""
    asked = []
    for env, image in dict.fromkeys((row["env"], row["image"]) for row in rows):
        slowest = max((row for row in rows if (row["env"], row["image"]) == (env, image)), key=lambda row: row["us"])
        what = f"{env} {image}: {slowest['feature']}, of the detector's time"
        asked.append(at_most(what, _ASKED, slowest["percent"], " %"))
    return asked


def _looks(env: Env, size: tuple[int, int], frames: int, seed: int, renderer: str) -> tuple[list[_Look], ShapeDetector]:
    """The frames of one episode with what a NumPy detector finds in them; and the detector."""
    from shape_obs_envs.d455 import D455Noise

    simulated = D455Noise(make_env(env, {"camera": size, "renderer": renderer}))
    defaults = env_protocol.defaults(simulated)
    detector = ShapeDetector(
        defaults["shapes"], defaults["segmentation"], dt=defaults["dt"], on_invalid="interpolate", backend="numpy"
    )
    actions = held_actions(np.random.default_rng(seed), simulated.action_space.shape or (), frames, 8)
    observation, _ = simulated.reset(seed=seed)
    looks = []
    for action in actions:
        named, camera = dict(env_protocol.anchors(simulated)), env_protocol.camera_model(simulated)
        point = env_protocol.base_point(detector.shapes[0], named)
        view = View(*size, camera, defaults["workspace"], anchor=point, anchors=named)
        shape = detector.detect(observation["rgb"], observation["depth"], camera, anchors=named).shapes[0]
        looks.append(_Look(observation["rgb"], observation["depth"], view, shape))
        observation = simulated.step(action)[0]
    simulated.close()
    detector.reset()
    return looks, detector


def _label(feature: Feature) -> str:
    more = {name: value for name, value in feature.to_dict().items() if name in ("harmonics", "degree", "order")}
    more |= {"coefficients": feature.coefficients} if feature.kind == "bspline" else {}  # type: ignore[attr-defined]
    return " ".join([feature.kind, *map(str, list(more.values())[-1:])])
