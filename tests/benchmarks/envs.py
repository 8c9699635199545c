"""Simulated environments: points against the simulator's truth, the physics, and the goals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any, Final, Literal, NamedTuple, get_args

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from tests.benchmarks import ENVS, Env
from tests.benchmarks.claim import Claim, Effort, Limit
from tests.benchmarks.scores import SLIP, belief, score, simulator_score
from tests.benchmarks.tables import Column, Row, failures, joined, mean, of, percent, total, worst

Array = npt.NDArray[np.float64]
Condition = Literal["clean", "noise", "randomised", "randomised, no hand"]
Camera = Literal["d455", "rl"]
CONDITIONS: Final[tuple[Condition, ...]] = get_args(Condition)
CAMERAS: Final[tuple[Camera, ...]] = get_args(Camera)
DIFFICULTIES: Final = ("near", "middle", "far")
EPISODE: Final = 50  # steps
_RANDOMIZE: Final[dict[Condition, Any]] = {"randomised": True, "randomised, no hand": {"hand": False}}
_ACTIONS: Final = 0xE9  # separates the actions from everything else that is drawn from an episode's seed
_REST: Final = 20  # steps after which the object should have come to rest


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


def held_actions(
    rng: np.random.Generator, shape: tuple[int, ...], steps: int, held: int = 1
) -> npt.NDArray[np.float32]:
    """Draw (steps, *shape) random actions, each held for ``held`` steps; white noise moves grippers less."""
    drawn = rng.uniform(-1, 1, (-(-steps // held), *shape))
    return np.repeat(drawn, held, axis=0)[:steps].astype(np.float32)


def is_finite(simulator: Any) -> bool:
    """Return whether the whole physics state is finite."""
    return bool(np.isfinite(simulator.get_state()).all())


def warnings(simulator: Any) -> int:
    """Return the number of MuJoCo's warnings since the last reset of the object."""
    return int(np.sum(simulator._body.data.warning.number))


def strain(simulator: Any) -> tuple[float, float]:
    """Return how much longer an object is than at rest, in all and at most between two neighbouring joints or masses.

    A strain of 0.05 is five percent. That of a rope or a band is measured along its middle line; both values of a sheet
    are the largest strain of an edge between its masses.
    """
    body, kind = simulator._body, simulator.goal_layout["kind"]
    if kind == "surface":
        return body.stretch(), body.stretch()
    if kind == "contour":
        line = body.axis()
        line, rest = np.concatenate([line, line[:1]]), np.full(len(line), body.spec.link_length)
    else:
        line = body.vertices()
        rest = np.full(len(line) - 1, body.spec.link_length)
        rest[[0, -1]] += body.spec.radius
    pieces = np.linalg.norm(np.diff(line, axis=0), axis=1)
    return float(pieces.sum() / rest.sum() - 1), float((pieces / rest).max() - 1)


def episodes(setting: Setting, seeds: Sequence[int], steps: int = EPISODE) -> list[Row]:
    """Run an episode of random actions for each seed; odd seeds hold each action for eight steps.

    Returns:
        A row for each episode with its setting: number of ``frames``, including the first one; ``mm``: mean errors of
        the points in the judged frames, in which the shape is ok and no sheet is folded, ``fresh_mm`` those of frames
        in which it was found, ``held`` the number of the others; ``slips``: judged frames with a valid point more than
        half a gap from its position on the material, ``slip`` the worst in gaps; ``flips``: judged frames whose points
        are numbered differently from the object's; ``not_ok``: frames in which the shape was reported not ok;
        ``folded``: frames of a sheet that hides a part of itself; ``broken``: frames in which the physics state was not
        finite; ``warnings``: of MuJoCo; ``whole`` and ``local``: the largest strains; ``beliefs``: of ``belief``, for
        each judged frame in which the shape was found.
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
        return [Row(_episode(env, seed, steps, goal), **setting._asdict()) for seed in seeds]
    finally:
        env.close()


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
    fresh = [frame for frame in judged if not frame.held]
    return Row(
        frames=len(frames),
        mm=[frame.mm for frame in judged],
        fresh_mm=[frame.mm for frame in fresh],
        held=len(judged) - len(fresh),
        slips=sum(frame.slip > SLIP for frame in judged),
        slipped=any(frame.slip > SLIP for frame in judged),
        slip=max((frame.slip for frame in judged), default=0.0),
        flips=sum(frame.flipped for frame in judged),
        not_ok=failures("ok")(frames),
        folded=failures("unfolded")(frames),
        broken=failures("finite")(frames),
        beliefs=[frame.belief for frame in fresh],
        warnings=warnings(simulator),
        whole=100 * max(frame.whole for frame in frames),
        local=100 * max(frame.local for frame in frames),
    )


def goals(scene: tuple[Env, str, int]) -> Row:
    """Draw a goal and play the actions that lead to it, without rendering.

    Returns:
        In millimetres between corresponding points: ``start``, the distance of the start from the goal, and ``played``,
        that left after the goal's own actions and a second of rest; ``warnings`` of MuJoCo.
    """
    env, difficulty, seed = scene
    simulated = make_env(env, {"render_observation": False, "difficulty": difficulty})
    simulator: Any = simulated.unwrapped
    _, info = simulated.reset(seed=seed)
    start = 1e3 * info["truth/mean_error"]
    for action in [*simulator.goal_actions, *np.zeros((_REST, *simulator.action_space.shape), np.float32)]:
        *_, info = simulated.step(action)
    found = Row(played=1e3 * info["truth/mean_error"], warnings=warnings(simulator))
    simulated.close()
    return Row(found, env=env, difficulty=difficulty, start=start)


def cable_episode(scene: tuple[Any, str, int]) -> Iterator[Row]:
    """Run random actions on ``Cable-v0`` and compare the visible surface that is detected with the simulator's."""
    from shape_obs.wrappers import ShapeObservation

    camera, renderer, seed = scene
    shapes = [{"kind": "centerline", "n": 20, "anchor": "gripper0", "ends": "tips", "spacing": "m"}]
    env = ShapeObservation(make_env("Cable", {"camera": camera, "renderer": renderer}), shapes)
    simulator: Any = env.unwrapped
    env.action_space.seed(seed)
    env.reset(seed=seed)
    for step in range(EPISODE + 1):
        assert env.detection is not None
        shape = env.detection.shapes[0]
        assert shape.points3d is not None
        axis, truth, pixels = (
            simulator.truth(n=n, frame=frame, surface=True)
            for n, frame in ((400, "camera"), (20, "camera"), (20, "pixels"))
        )
        found, mm = score(shape.points3d, axis, "tips"), 1e3 * _apart(shape.points3d, truth)
        slipped = found.slip > SLIP
        row = Row(found, ok=shape.ok, slipped=slipped, wrong=shape.ok and (slipped or mm > 15), mm=mm)
        yield Row(row, camera=str(camera), px=_apart(shape.pixels, pixels))
        if step < EPISODE:
            env.step(env.action_space.sample())
    env.close()


def _apart(points: npt.NDArray[Any], truth: npt.NDArray[Any]) -> float:
    return float(np.linalg.norm(points - truth, axis=1).mean())


COLUMNS: Final[dict[str, Column]] = {
    "episodes": len,
    "frames": total("frames"),
    "mean [mm]": joined(mean, "mm"),
    "worst frame [mm]": joined(max, "mm"),
    "found, mean [mm]": joined(mean, "fresh_mm"),
    "held [%]": percent("held", "frames"),
    "not ok [%]": percent("not_ok", "frames"),
    "folded [%]": percent("folded", "frames"),
    "slips": total("slips"),
    "episodes with slips [%]": percent("slipped"),
    "worst slip [gaps]": of(worst, "slip"),
    "flips": total("flips"),
    "not finite": total("broken"),
    "warnings": total("warnings"),
    "longer [%]": of(worst, "whole"),
    "longest piece [%]": of(worst, "local"),
}
# Limits of the mean error over all judged frames in millimetres: clean, noise, randomised.
_MEAN: Final[dict[Env, tuple[float, float, float]]] = {
    "Cable": (3, 5, 8), "Ring": (3, 5, 8), "Cloth": (6, 8, 12), "Hanging": (3, 5, 8),
}  # fmt: skip


def _points(env: Env) -> Claim:
    """Return the claim about the points, and the physics, of an environment."""

    def scenes(effort: Effort) -> Iterator[tuple[Setting, range]]:
        seeds = effort.seeds(150)
        chunks = [seeds[first : first + 10] for first in range(0, len(seeds), 10)]
        return (
            (Setting(env, camera, how, effort.renderer), chunk)
            for camera, how, chunk in product(CAMERAS, CONDITIONS, chunks)
        )

    where = [{"camera": "d455", "condition": how} for how in ("clean", "noise", CONDITIONS[2:])]
    means = (Limit("mean [mm]", at_most=most, unit="mm", where=at) for most, at in zip(_MEAN[env], where, strict=True))
    steep = "a rope that runs steeply towards the camera" if env == "Hanging" else ""
    slips = (
        Limit("episodes with slips [%]", at_most=most, unit="%", where=at, known=steep)
        for most, at in zip((0, 0, 0.7), where, strict=True)
    )
    longest = {"Cloth": 10, "Ring": 3}.get(env, 2)
    physics = (
        Limit("not finite", at_most=0), Limit("warnings", at_most=0), Limit("flips", at_most=0),
        Limit("longest piece [%]", at_most=longest, unit="%"),
    )  # fmt: skip
    what = f"{env}-v0 under random actions: points that a policy receives against the truth, and the physics."
    by = ("camera", "condition")
    return Claim(
        f"envs.{env}", what, scenes, lambda scene: episodes(*scene), by, COLUMNS, limits=(*means, *slips, *physics),
        needs=("mujoco",),
    )  # fmt: skip


CLAIMS: Final = (
    *(_points(env) for env in ENVS),
    Claim(
        "envs.goals", "Goals of every environment and difficulty, and where their own actions lead.",
        lambda effort: product(ENVS, DIFFICULTIES, effort.seeds(50)), goals, ("env", "difficulty"),
        {"episodes": len, "start, mean [mm]": of(mean, "start"), "start, farthest [mm]": of(worst, "start"),
         "played, mean [mm]": of(mean, "played"), "played, worst [mm]": of(worst, "played"),
         "warnings": total("warnings")},
        limits=(
            Limit("start, farthest [mm]", at_most=50, unit="mm", where={"difficulty": "near"}),
            Limit("start, farthest [mm]", at_most=100, unit="mm", where={"difficulty": "middle"}),
            Limit("played, worst [mm]", at_most=5, unit="mm"), Limit("warnings", at_most=0),
        ),
        needs=("mujoco",),
    ),
    Claim(
        "envs.surface", "The visible surface of the simulated cable under random actions, by camera.",
        lambda effort: product(("d455", "rl", [84, 84]), (effort.renderer,), effort.seeds(20)), cable_episode,
        ("camera",),
        {"frames": len, "flips": total("flipped"), "slips": total("slipped"), "refused": failures("ok"),
         "wrong, not reported": total("wrong"), "mean [mm]": of(mean, "mm"), "worst frame [mm]": of(worst, "mm"),
         "mean [px]": of(mean, "px"), "worst frame [px]": of(worst, "px")},
        limits=(
            Limit("flips", at_most=0), Limit("refused", at_most=0),
            Limit("wrong, not reported", at_most=0, where={"camera": ("d455", "rl")}),
            Limit("mean [mm]", at_most=3, unit="mm"), Limit("mean [px]", at_most=1, unit="px"),
        ),
        needs=("mujoco",),
    ),
)  # fmt: skip
