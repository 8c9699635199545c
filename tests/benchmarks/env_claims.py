"""Measure the accuracy on the simulated environments: the camera's points against the simulator's truth.

The images are clean, with the camera's noise, or randomised with and without a hand in the image.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from shape_obs.utils.threads import one_thread
from tests.benchmarks import ENVS, Env, run_tasks
from tests.benchmarks.env_physics import EPISODE, held_actions, is_finite, make_env, strain, warnings
from tests.benchmarks.scores import SLIP, belief, simulator_score
from tests.benchmarks.tables import Row, at_most, failures, mean, of, summary

Condition = Literal["clean", "noise", "randomised", "randomised, no hand"]
Camera = Literal["d455", "rl"]

CONDITIONS: Final[tuple[Condition, ...]] = get_args(Condition)
CAMERAS: Final[tuple[Camera, ...]] = get_args(Camera)
_RANDOMIZE: Final[dict[Condition, Any]] = {"randomised": True, "randomised, no hand": {"hand": False}}
_CHUNK: Final = 10  # episodes for which an environment is made
_ACTIONS: Final = 0xE9  # separates the actions from everything else that is drawn from an episode's seed
# Targets of the mean error over all judged frames in millimetres, in the order of the conditions.
_TARGETS: Final[dict[Env, tuple[float, ...]]] = {
    "Cable": (3, 5, 8, 8),
    "Ring": (3, 5, 8, 8),
    "Cloth": (6, 8, 12, 12),
    "Hanging": (3, 5, 8, 8),
}
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


def episodes(setting: Setting, seeds: Sequence[int], steps: int = EPISODE) -> list[Row]:
    """Run an episode of random actions for each seed; odd seeds hold each action for eight steps.

    Returns:
        A row for each episode with its setting: number of ``frames``, including the first one; ``mm``: mean errors of
        the points in the judged frames, in which the shape is ok and no sheet is folded, ``held_mm`` those of frames in
        which the shape was not found and the last one was held; ``slips``: judged frames with a valid point more than
        half a gap from its position on the material, ``worst_slip`` in gaps; ``flips``: judged frames whose points are
        numbered differently from the object's; ``not_ok``: frames in which the shape was reported not ok; ``folded``:
        frames of a sheet that hides a part of itself; ``broken``: frames in which the physics state was not finite;
        ``warnings``: of MuJoCo; ``whole`` and ``local``: the largest strains; ``beliefs``: of ``belief``, for each
        judged frame in which the shape was found.
    """
    from shape_obs.wrappers import ShapeObservation
    from shape_obs_envs.d455 import D455Noise

    how = _RANDOMIZE.get(setting.condition)
    more = {} if how is None else {"randomize": how}
    env: Any = make_env(setting.env, {"camera": setting.camera, "renderer": setting.renderer, **more})
    env = ShapeObservation(D455Noise(env) if setting.condition == "noise" else env)
    # The goal does not matter, and drawing one takes longer than the episode.
    goal = env.unwrapped.truth()
    try:
        with one_thread():
            return [Row(setting=setting, **setting._asdict(), **_episode(env, seed, steps, goal)) for seed in seeds]
    finally:
        env.close()


def all_episodes(
    settings: Sequence[Setting],
    seeds: Sequence[int],
    jobs: int = 1,
    steps: int = EPISODE,
    report: Callable[[str], object] = lambda text: None,
) -> list[Row]:
    """Run the same episodes under several settings, and return them setting by setting.

    Args:
        settings: The settings.
        seeds: One seed for each episode.
        jobs: Number of processes.
        steps: Steps of an episode.
        report: Called with the progress.
    """
    chunks = [list(seeds[first : first + _CHUNK]) for first in range(0, len(seeds), _CHUNK)]
    found: list[Row] = []
    for some in run_tasks(episodes, [(setting, chunk, steps) for setting in settings for chunk in chunks], jobs):
        found += some
        report(f"episode {len(found)} of {len(settings) * len(seeds)}")
    return sorted(found, key=lambda row: settings.index(row.setting))


def settings(renderer: str) -> list[Setting]:
    """Return the settings of every environment, camera and condition."""
    return [Setting(env, camera, how, renderer) for env in ENVS for camera in CAMERAS for how in CONDITIONS]


def claim_table(found: Iterable[Row]) -> list[Row]:
    """Summarise all episodes of each setting; shares are in percent of all frames or of all episodes.

    ``mean_mm`` is over all judged frames, ``found_mean_mm`` over those in which the shape was found and not held.
    """

    def errors(rows: list[Row], field: str) -> list[float]:
        return [mm for row in rows for mm in row[field]]

    def percent(part: float, rows: list[Row]) -> float:
        return 100 * part / sum(row.frames for row in rows)

    def fresh(rows: list[Row]) -> float | None:
        judged, held = errors(rows, "mm"), errors(rows, "held_mm")
        return (sum(judged) - sum(held)) / (len(judged) - len(held)) if len(judged) > len(held) else None

    columns = {
        "episodes": len,
        "frames": of(sum, "frames"),
        "mean_mm": lambda rows: mean(errors(rows, "mm")) if errors(rows, "mm") else None,
        "worst_frame_mm": lambda rows: max(errors(rows, "mm"), default=None),
        "found_mean_mm": fresh,
        "held_percent": lambda rows: percent(len(errors(rows, "held_mm")), rows),
        "slips": of(sum, "slips"),
        "episodes_with_slips_percent": of(lambda slips: 100 * sum(each > 0 for each in slips) / len(slips), "slips"),
        "worst_slip": of(max, "worst_slip"),
        "flips": of(sum, "flips"),
        "not_ok": of(sum, "not_ok"),
        "not_ok_percent": lambda rows: percent(sum(row.not_ok for row in rows), rows),
        "folded_percent": lambda rows: percent(sum(row.folded for row in rows), rows),
    }
    return summary(found, ("env", "camera", "condition"), columns)


def physics_table(found: Iterable[Row]) -> list[Row]:
    """Summarise the physics over all episodes of each environment; strains are in percent."""
    columns = {
        "episodes": len,
        "states": of(sum, "frames"),
        "not_finite": of(sum, "broken"),
        "warnings": of(sum, "warnings"),
        "longer_percent": of(lambda strains: 100 * max(strains), "whole"),
        "longest_piece_percent": of(lambda strains: 100 * max(strains), "local"),
    }
    return summary(found, ("env",), columns)


def targets(rows: Sequence[Row], physics: Sequence[Row]) -> list[Row]:
    """Compare the environments at a D455's image size and the physics with their targets."""
    compared: list[Row] = []
    for row in rows:
        if row.camera != "d455":
            continue
        which, what = CONDITIONS.index(row.condition), f"{row.env}, {row.condition}"
        compared.append(at_most(f"{what}: mean error", _TARGETS[row.env][which], row.mean_mm, " mm"))
        share = row.episodes_with_slips_percent
        compared.append(at_most(f"{what}: episodes in which the index slips", _SLIPPED[which], share, " %"))
    for row in physics:
        for name, what in (("not_finite", "states that are not finite"), ("warnings", "warnings of MuJoCo")):
            compared.append(at_most(f"{row.env}: {what}", 0, row[name], ""))
    return compared


def _episode(env: Any, seed: int, steps: int, goal: npt.NDArray[Any]) -> Row:
    simulator = env.unwrapped
    actions = held_actions(np.random.default_rng((_ACTIONS, seed)), env.action_space.shape, steps, 8 if seed % 2 else 1)
    frames: list[Row] = []
    observation, _ = env.reset(seed=seed, options={"goal": goal})
    for step in range(steps + 1):
        shape, unfolded = env.detection.shapes[0], getattr(simulator, "unfolded", True)
        points = observation["achieved_goal"].astype(np.float64).reshape(-1, 3)
        frame = Row(ok=shape.ok, unfolded=unfolded, held=bool(shape.reason), finite=is_finite(simulator))
        if shape.ok and unfolded:
            frame.update(simulator_score(points, shape.valid, shape.layout, simulator))
            frame.update(belief=belief(shape, frame.errors, shape.visible, frame.slip > SLIP))
        whole, local = strain(simulator)
        frames.append(Row(frame, whole=whole, local=local))
        if step < steps:
            observation = env.step(actions[step])[0]
    judged = [frame for frame in frames if frame.ok and frame.unfolded]
    return Row(
        frames=len(frames),
        mm=[frame.mm for frame in judged],
        held_mm=[frame.mm for frame in judged if frame.held],
        slips=sum(frame.slip > SLIP for frame in judged),
        worst_slip=max((frame.slip for frame in judged), default=0.0),
        flips=sum(frame.flipped for frame in judged),
        not_ok=failures("ok")(frames),
        folded=failures("unfolded")(frames),
        broken=failures("finite")(frames),
        beliefs=[frame.belief for frame in judged if not frame.held],
        warnings=warnings(simulator),
        whole=max(frame.whole for frame in frames),
        local=max(frame.local for frame in frames),
    )
