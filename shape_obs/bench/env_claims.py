"""Measure the accuracy on the simulated environments: the camera's points against the simulator's truth.

The images are clean, with the camera's noise, or randomised with and without a hand in the image.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from shape_obs.bench import ENVS, Env, run_tasks
from shape_obs.bench.env_physics import EPISODE, Strain, held_actions, is_finite, strain, warnings
from shape_obs.bench.scores import simulator_score
from shape_obs.bench.tables import Row, at_most
from shape_obs.utils.threads import one_thread

Condition = Literal["clean", "noise", "randomised", "randomised, no hand"]
Camera = Literal["d455", "rl"]

CONDITIONS: Final[tuple[Condition, ...]] = get_args(Condition)
CAMERAS: Final[tuple[Camera, ...]] = get_args(Camera)
_RANDOMIZE: Final[dict[Condition, Any]] = {"randomised": True, "randomised, no hand": {"hand": False}}
_CHUNK: Final = 10  # episodes for which an environment is made
_SLIP: Final = 0.5  # gaps
_ACTIONS: Final = 0xE9  # separates the actions from everything else that is drawn from an episode's seed
# Targets of the mean error over all judged frames in millimetres, in the order of the conditions.
_TARGETS: Final[dict[Env, tuple[float, ...]]] = {"Cable": (3, 5, 8, 8), "Ring": (3, 5, 8, 8), "Cloth": (6, 8, 12, 12)}
_SLIPPED: Final = (0, 0, 0.5, 0.5)  # percent of the episodes


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


class Episode(NamedTuple):
    """One episode of random actions.

    Args:
        frames: Number of frames, including the first one.
        mm: Mean error of the points in each judged frame: the shape is ok, and no sheet is folded.
        held_mm: Those errors of frames in which the shape was not found and the last one was held.
        slips: Judged frames with a valid point more than half a gap from its position on the material.
        worst_slip: The largest such distance, in gaps.
        flips: Judged frames whose points are numbered differently from the object's.
        not_ok: Frames in which the shape was reported not ok.
        folded: Frames of a sheet that hides a part of itself; they are not judged.
        broken: Frames in which the physics state was not finite.
        warnings: Warnings of MuJoCo.
        strain: The largest strain.
    """

    frames: int
    mm: tuple[float, ...]
    held_mm: tuple[float, ...]
    slips: int
    worst_slip: float
    flips: int
    not_ok: int
    folded: int
    broken: int
    warnings: int
    strain: Strain


def episodes(setting: Setting, seeds: Sequence[int], steps: int = EPISODE) -> list[Episode]:
    """Run an episode of random actions for each seed; odd seeds hold each action for eight steps."""
    import gymnasium as gym

    from shape_obs.wrappers import ShapeObservation
    from shape_obs_envs.d455 import D455Noise

    how = _RANDOMIZE.get(setting.condition)
    more = {} if how is None else {"randomize": how}
    env: Any = gym.make(
        f"shape_obs_envs:ShapeObs/{setting.env}-v0", camera=setting.camera, renderer=setting.renderer, **more
    )
    env = ShapeObservation(D455Noise(env) if setting.condition == "noise" else env)
    simulator: Any = env.unwrapped
    # The goal does not matter, and drawing one takes longer than the episode.
    goal = simulator.truth()
    try:
        with one_thread():
            return [_episode(env, seed, steps, goal) for seed in seeds]
    finally:
        env.close()


def all_episodes(
    settings: Sequence[Setting],
    seeds: Sequence[int],
    jobs: int = 1,
    steps: int = EPISODE,
    tick: Callable[[int], object] = lambda done: None,
) -> dict[Setting, list[Episode]]:
    """Run the same episodes under several settings.

    Args:
        settings: The settings.
        seeds: One seed for each episode.
        jobs: Number of processes.
        steps: Steps of an episode.
        tick: Called with the number of further episodes that are done.
    """
    chunks = [list(seeds[first : first + _CHUNK]) for first in range(0, len(seeds), _CHUNK)]
    tasks = [(setting, chunk, steps) for setting in settings for chunk in chunks]
    found: dict[Setting, list[Episode]] = {setting: [] for setting in settings}
    for setting, some in run_tasks(_chunk, tasks, jobs):
        found[setting] += some
        tick(len(some))
    return found


def settings(renderer: str, envs: Sequence[Env] = ENVS) -> list[Setting]:
    """Return the settings of every environment, camera and condition."""
    return [Setting(env, camera, how, renderer) for env in envs for camera in CAMERAS for how in CONDITIONS]


def claim_row(setting: Setting, found: Sequence[Episode]) -> Row:
    """Summarise all episodes of a setting; shares are in percent of all frames or of all episodes.

    ``mean_mm`` is over all judged frames, ``found_mean_mm`` over those in which the shape was found and not held.
    """
    frames = sum(each.frames for each in found)
    judged, held = [mm for each in found for mm in each.mm], [mm for each in found for mm in each.held_mm]
    fresh = (sum(judged) - sum(held)) / (len(judged) - len(held)) if len(judged) > len(held) else None
    return {
        "env": setting.env,
        "camera": setting.camera,
        "condition": setting.condition,
        "episodes": len(found),
        "frames": frames,
        "mean_mm": float(np.mean(judged)) if judged else None,
        "worst_frame_mm": max(judged, default=None),
        "found_mean_mm": fresh,
        "held_percent": 100 * len(held) / frames,
        "slips": sum(each.slips for each in found),
        "episodes_with_slips_percent": 100 * sum(each.slips > 0 for each in found) / len(found),
        "worst_slip": max(each.worst_slip for each in found),
        "flips": sum(each.flips for each in found),
        "not_ok": sum(each.not_ok for each in found),
        "not_ok_percent": 100 * sum(each.not_ok for each in found) / frames,
        "folded_percent": 100 * sum(each.folded for each in found) / frames,
    }


def physics_row(env: Env, found: Sequence[Episode]) -> Row:
    """Summarise the physics over all episodes of an environment; strains are in percent."""
    return {
        "env": env,
        "episodes": len(found),
        "states": sum(each.frames for each in found),
        "not_finite": sum(each.broken for each in found),
        "warnings": sum(each.warnings for each in found),
        "longer_percent": 100 * max(each.strain.whole for each in found),
        "longest_piece_percent": 100 * max(each.strain.local for each in found),
    }


def targets(rows: Sequence[Row], physics: Sequence[Row]) -> list[Row]:
    """Compare the errors at the D455's image size and the physics with their targets."""
    compared: list[Row] = []
    for row in rows:
        if row["camera"] != "d455":
            continue
        which, what = CONDITIONS.index(row["condition"]), f"{row['env']}, {row['condition']}"
        compared.append(at_most(f"{what}: mean error", _TARGETS[row["env"]][which], row["mean_mm"], " mm"))
        share = row["episodes_with_slips_percent"]
        compared.append(at_most(f"{what}: episodes in which the index slips", _SLIPPED[which], share, " %"))
    for row in physics:
        for name, what in (("not_finite", "states that are not finite"), ("warnings", "warnings of MuJoCo")):
            compared.append(at_most(f"{row['env']}: {what}", 0, row[name], ""))
    return compared


def _chunk(setting: Setting, seeds: Sequence[int], steps: int) -> tuple[Setting, list[Episode]]:
    return setting, episodes(setting, seeds, steps)


def _episode(env: Any, seed: int, steps: int, goal: npt.NDArray[Any]) -> Episode:
    simulator = env.unwrapped
    actions = held_actions(np.random.default_rng((_ACTIONS, seed)), env.action_space.shape, steps, 8 if seed % 2 else 1)
    mm: list[float] = []
    held: list[float] = []
    slips: list[float] = []
    strains: list[Strain] = []
    flips = not_ok = folded = broken = 0
    observation, _ = env.reset(seed=seed, options={"goal": goal})
    for step in range(steps + 1):
        shape, flat = env.detection.shapes[0], getattr(simulator, "unfolded", True)
        not_ok, folded = not_ok + (not shape.ok), folded + (not flat)
        if shape.ok and flat:
            points = observation["achieved_goal"].astype(np.float64).reshape(-1, 3)
            seen = simulator_score(points, shape.valid, shape.layout, simulator)
            mm.append(seen.mm)
            if shape.reason:
                held.append(seen.mm)
            slips.append(seen.slip)
            flips += seen.flipped
        broken += not is_finite(simulator)
        strains.append(strain(simulator))
        if step < steps:
            observation = env.step(actions[step])[0]
    worst = Strain(max(each.whole for each in strains), max(each.local for each in strains))
    return Episode(
        frames=steps + 1,
        mm=tuple(mm),
        held_mm=tuple(held),
        slips=sum(slip > _SLIP for slip in slips),
        worst_slip=max(slips, default=0.0),
        flips=flips,
        not_ok=not_ok,
        folded=folded,
        broken=broken,
        warnings=warnings(simulator),
        strain=worst,
    )
