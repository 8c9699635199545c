"""Simulated environments: points against the simulator's truth, and the physics."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing
from itertools import product
from typing import Any, Final, Literal, NamedTuple, get_args

import gymnasium as gym
import numpy as np

from tests.benchmarks import ENVS, Env
from tests.benchmarks.claim import Claim, Effort, Limit
from tests.benchmarks.scores import SLIP, belief, simulator_score
from tests.benchmarks.tables import Column, Row, failures, mean, of, percent, total, worst

Condition = Literal["clean", "noise", "randomised"]
Camera = Literal["d455", "rl"]
CONDITIONS: Final[tuple[Condition, ...]] = get_args(Condition)
CAMERAS: Final[tuple[Camera, ...]] = get_args(Camera)
_EPISODE: Final = 50  # steps
_ACTIONS: Final = 0xE9  # separates the actions from everything else that is drawn from an episode's seed


class Setting(NamedTuple):
    """An environment and its images.

    Args:
        env: The environment.
        camera: ``"d455"`` (640 x 480) or ``"rl"`` (160 x 120).
        condition: ``"clean"``, ``"noise"`` (that of a D455), or a randomised one without noise.
        renderer: ``"auto"``, ``"gl"`` or ``"rays"``.
    """

    env: Env
    camera: Camera
    condition: Condition
    renderer: str


def make_env(name: str, options: Mapping[str, Any]) -> gym.Env[Any, Any]:
    """Make an environment as trainers do, without Gymnasium's checker; it never ends an episode by itself."""
    return gym.make(f"shape_obs_envs:ShapeObs/{name}-v0", disable_env_checker=True, max_episode_steps=-1, **options)


def strain(simulator: Any) -> float:
    """Return the largest strain of an edge of a sheet or a link of a ring in percent; the links of ropes are rigid."""
    body, kind = simulator._body, simulator.goal_layout["kind"]
    if kind == "surface":
        return 100 * body.stretch()
    if kind == "contour":
        hinges = body.axis()
        links = np.linalg.norm(np.roll(hinges, -1, axis=0) - hinges, axis=1)
        return float(100 * (links.max() / body.spec.link_length - 1))
    return 0.0


def episodes(setting: Setting, seeds: Iterable[int]) -> Iterator[Row]:
    """Run an episode of random actions for each seed; odd seeds hold each action for eight steps.

    Yields:
        A row for each frame with the setting: whether the shape is ``ok``; whether a sheet is ``folded`` and so hides a
        part of itself; whether the physics state is not finite (``broken``); MuJoCo's ``warnings``; ``strain``. If it
        is ok and not folded: ``mm``, the mean error of the points; ``held``: whether it was not found; ``slip``: the
        farthest of a valid point from its position on the material, in gaps; ``slipped``: whether that is more than
        half a gap; ``flipped``: whether the points are numbered differently from the object's; and, if it was found,
        ``belief``.
    """
    from shape_obs.wrappers import ShapeObservation
    from shape_obs_envs.d455 import D455Noise

    options = {"camera": setting.camera, "renderer": setting.renderer, "randomize": setting.condition == "randomised"}
    env: Any = make_env(setting.env, options)
    env = ShapeObservation(D455Noise(env) if setting.condition == "noise" else env)
    simulator = env.unwrapped
    # The goal does not matter, and drawing one takes longer than the episode.
    goal, shape_of = simulator.truth(), env.action_space.shape
    with closing(env):
        for seed in seeds:
            held = 8 if seed % 2 else 1  # white noise moves grippers less
            drawn = np.random.default_rng((_ACTIONS, seed)).uniform(-1, 1, (-(-_EPISODE // held), *shape_of))
            observation, _ = env.reset(seed=seed, options={"goal": goal})
            for action in [*np.repeat(drawn, held, axis=0)[:_EPISODE].astype(np.float32), None]:
                shape, folded = env.detection.shapes[0], not getattr(simulator, "unfolded", True)
                row = Row(setting._asdict(), ok=shape.ok, folded=folded, strain=strain(simulator))
                row.update(mm=np.nan, held=False, slip=0.0, slipped=False, flipped=False, belief=None)
                row["broken"] = not np.isfinite(simulator.get_state()).all()
                row["warnings"] = int(np.sum(simulator._body.data.warning.number))
                if shape.ok and not folded:
                    points = observation["achieved_goal"].astype(np.float64).reshape(-1, 3)
                    row.update(simulator_score(points, shape.valid, shape.layout, simulator), held=bool(shape.reason))
                    row["slipped"] = row.slip > SLIP
                    if not shape.reason:
                        row["belief"] = belief(shape, row.errors, shape.visible, row.slipped)
                yield row
                if action is not None:
                    observation = env.step(action)[0]


COLUMNS: Final[dict[str, Column]] = {
    "frames": len,
    "mean [mm]": of(mean, "mm"),
    "worst frame [mm]": of(worst, "mm"),
    "held [%]": percent("held"),
    "not ok [%]": lambda rows: 100 * failures("ok")(rows) / len(rows),
    "folded [%]": percent("folded"),
    "slips": total("slipped"),
    "slips [%]": percent("slipped"),
    "worst slip [gaps]": of(worst, "slip"),
    "flips": total("flipped"),
    "not finite": total("broken"),
    "warnings": of(worst, "warnings"),
    "strain [%]": of(worst, "strain"),
}
# Limits of the mean error over all judged frames in millimetres: clean, noise, randomised.
_MEAN: Final[dict[Env, tuple[float, float, float]]] = {
    "Cable": (3, 5, 8), "Ring": (3, 5, 8), "Cloth": (6, 8, 12), "Hanging": (3, 5, 8),
}  # fmt: skip
_STRAIN: Final[dict[Env, float]] = {"Cloth": 10, "Ring": 3}


def _points(env: Env) -> Claim:
    """Return the claim about the points, and the physics, of an environment."""

    def scenes(effort: Effort) -> Iterable[tuple[Setting, range]]:
        seeds = effort.seeds(150)
        chunks = [seeds[first : first + 10] for first in range(0, len(seeds), 10)]
        settings = [Setting(env, camera, how, effort.renderer) for camera, how in product(CAMERAS, CONDITIONS)]
        return product(settings, chunks)

    where = [{"camera": "d455", "condition": how} for how in CONDITIONS]
    means = (Limit("mean [mm]", at_most=most, unit="mm", where=at) for most, at in zip(_MEAN[env], where, strict=True))
    steep = "a rope that runs steeply towards the camera" if env == "Hanging" else ""
    slips = (
        Limit("slips [%]", at_most=most, unit="%", where=at, known=steep, sampled={"Cloth": 1}.get(env))
        for most, at in zip((0, 0, 0.02), where, strict=True)
    )
    physics = [Limit(column, at_most=0) for column in ("not finite", "warnings", "flips")]
    physics += [Limit("strain [%]", at_most=_STRAIN[env], unit="%")] if env in _STRAIN else []
    what = f"{env}-v0 under random actions: points that a policy receives against the truth, and the physics."
    by, limits = ("camera", "condition"), (*means, *slips, *physics)
    return Claim(f"envs.{env}", what, scenes, lambda at: episodes(*at), by, COLUMNS, limits=limits, needs=("mujoco",))


CLAIMS: Final = tuple(_points(env) for env in ENVS)
