"""The cables environment: its truth, its contacts, its goals and its images."""

from __future__ import annotations

from itertools import combinations
from typing import Any, cast

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("mujoco")


import shape_obs_envs  # noqa: F401
from shape_obs import ShapeGoal
from shape_obs_envs.mujoco.bodies import MaterialFactors
from shape_obs_envs.mujoco.bodies.crossings import intersections
from shape_obs_envs.mujoco.cables import CablesEnv

Array = np.ndarray[Any, Any]


def make(**options: Any) -> CablesEnv:
    env = gym.make("ShapeObs/Cables-v0", **{"camera": [84, 84], "renderer": "rays", **options})
    return cast(CablesEnv, env.unwrapped)


def start(env: CablesEnv, seed: int) -> dict[str, Any]:
    """Reset without the search for a goal."""
    return env.reset(seed=seed, options={"goal": env._goal})[0]


def place(line: Array, at: float) -> Array:
    """Return the point of a polyline at a place in segments from its start."""
    i = int(at)
    return line[i] + (at - i) * (line[i + 1] - line[i])


def windings(env: CablesEnv) -> tuple[list[int], float]:
    """Return for each two ropes the signed crossings with the first above, and with the second above.

    Neither changes when ropes are bent, lifted or slid over each other, only when one passes through the other, or
    slides over its end. The second value is the distance of the crossing that is nearest to an end, in links.
    """
    out, nearest = [], float("inf")
    for one, other in combinations(env._ropes.vertices(), 2):
        signs = [0, 0]
        for s, t in intersections(one[:, :2], other[:, :2]):
            u, v = one[int(s) + 1] - one[int(s)], other[int(t) + 1] - other[int(t)]
            below = place(one, s)[2] < place(other, t)[2]
            signs[int(below)] += int(np.sign(u[0] * v[1] - u[1] * v[0]))
            nearest = min(nearest, s, t, len(one) - 1 - max(s, t))
        out += signs
    return out, nearest


def drag(env: CablesEnv, seed: int, steps: int = 50) -> None:
    """Check that no rope passes through another one or the table while grippers pull at full strength."""
    rng, action = np.random.default_rng(seed), np.zeros(env.action_space.shape or ())
    (before, nearest), ropes = windings(env), env._ropes
    for step in range(steps):
        if step % 6 == 0:
            action = np.sign(rng.uniform(-1, 1, action.shape))
        env._move(action)
        contact = ropes.data.contact
        assert contact.dist.min(initial=0.0) > -0.8 * ropes.spec.radius, "less than 0.4 of the thickness"
        assert ropes.vertices()[..., 2].min() > 0.4 * ropes.spec.radius
        assert ropes.vertices()[..., 2].max() < 0.06
        assert np.abs(ropes.data.qvel).max() < 50
        assert np.abs(ropes.gripper_poses()[:, :2] - env._target[:, :2]).max() < 0.02, "the grippers keep up"
        after = windings(env)
        assert after[0] == before or min(nearest, after[1]) < 1.5
        before, nearest = after
    assert np.isfinite(env.get_state()).all()
    assert not any(warning.number for warning in ropes.data.warning)


@pytest.fixture(scope="module")
def env():
    env = make()
    yield env
    env.close()


# ---- the truth


def test_truth_runs_from_end_to_end_of_every_rope(env):
    start(env, 2)
    for rope in range(3):
        fine = env.truth(4001, rope=rope)
        assert np.linalg.norm(np.diff(fine, axis=0), axis=1).sum() == pytest.approx(0.5, abs=1e-4)
        assert np.allclose(env.truth(11, rope=rope), fine[::400])
        assert np.allclose(env.truth(10, ends="centers", rope=rope), fine[200::400])
        assert np.allclose(env.truth(9, rope="all").reshape(3, 9, 3)[rope], fine[::500])
    assert list(env.anchors) == ["gripper0", "gripper1", "socket2"]
    for rope, name in enumerate(env.anchors):
        assert np.allclose(env.anchors[name], env.truth(rope=rope)[0])
        if rope < 2:
            assert np.allclose(env._observe()["gripper"].reshape(2, 5)[rope, :3], env.anchors[name], atol=1e-6)
    with pytest.raises(ValueError, match="rope: expected a whole number, from 0 to 2, got 3"):
        env.truth(rope=3)


@pytest.mark.parametrize(("rope", "points"), [(0, 20), (1, 20), ("all", 60)])
def test_the_goal_is_that_of_the_named_rope_or_of_all(rope, points):
    env = make(rope=rope, render_observation=False)
    observation, info = env.reset(seed=1)
    assert observation["desired_goal"].shape == (3 * points,)
    assert np.array_equal(info["truth/points"], env.truth(rope=rope).astype(np.float32))
    moved = np.linalg.norm((env._goal - observation["achieved_goal"]).reshape(-1, 3), axis=1)
    assert moved.mean() > 0.02
    (shape,) = env.shape_obs_defaults["shapes"]
    assert shape["count"] == 3
    assert shape["anchor"]["centerline0"] == ("gripper1" if rope == 1 else "gripper0")
    assert shape["anchor"]["centerline1"] == ("gripper0" if rope == 1 else "gripper1")


def test_with_one_gripper_the_other_ropes_are_in_sockets():
    env = make(ropes=2, grippers=1, render_observation=False)
    start(env, 3)
    ends = env._ropes.end_poses()
    assert list(env.anchors) == ["gripper0", "socket1"]
    for _ in range(10):
        env._move(np.array([1.0, 0.5, -0.2]))
    moved = np.linalg.norm(env._ropes.end_poses()[..., :2] - ends[..., :2], axis=2)
    assert moved[0, 0] > 0.03
    assert max(moved[0, 1], *moved[1]) < 2e-3


# ---- how the ropes lie


@pytest.mark.parametrize("ropes", [2, 3])
def test_at_the_start_they_lie_over_each_other_and_on_the_table(ropes):
    env = make(ropes=ropes, render_observation=False)
    above = []
    for seed in range(8):
        start(env, seed)
        vertices, radius = env._ropes.vertices(), env._ropes.spec.radius
        assert vertices[..., 2].min() > 0.8 * radius
        assert (np.abs(vertices[..., 2] - radius) < 1e-3).mean() > 0.3, "a third lies flat"
        crossings = env.crossings()
        assert len(crossings) >= ropes - 1
        for crossing in crossings:
            upper, lower = (
                env._ropes.points(np.array([at]))[rope, 0]
                for rope, at in ((crossing.above, crossing.above_at), (crossing.below, crossing.below_at))
            )
            assert upper[2] - lower[2] > 1.6 * radius
            assert np.linalg.norm(upper[:2] - lower[:2]) < 6e-3  # seen obliquely
        above += [crossing.above for crossing in crossings]
    assert set(above) == set(range(ropes))


def test_the_image_shows_the_upper_rope(env):
    env = make(camera="d455")
    for seed in range(3):
        observation = start(env, seed)
        for crossing in env.crossings():
            u, v = np.rint(crossing.pixel).astype(int)
            away, farther = (
                env.camera_model.from_base(env._ropes.points(np.array([at]))[rope])[0, 2] - env._ropes.spec.radius
                for rope, at in ((crossing.above, crossing.above_at), (crossing.below, crossing.below_at))
            )
            assert observation["depth"][v, u] / 1000 == pytest.approx(away, abs=2e-3)
            assert farther - away > 0.01


@pytest.mark.parametrize(
    ("ropes", "factors"),
    [
        (2, MaterialFactors()),
        (3, MaterialFactors()),
        (3, MaterialFactors(0.75, 0.5, 0.5, 1 / 1.6)),
        (3, MaterialFactors(1.25, 2.0, 2.0, 1.6)),
        (3, MaterialFactors(1.25, 0.5, 2.0, 0.7)),
    ],
    ids=["two", "three", "limp and thin", "stiff and thick", "limp and thick"],
)
def test_ropes_of_any_material_stay_above_or_below_when_they_are_dragged(ropes, factors):
    env = make(ropes=ropes, render_observation=False)
    env._body.set_material(factors)
    for seed in range(2):
        start(env, seed)
        drag(env, seed)


def test_a_gripper_that_pulls_at_a_jammed_rope_stops():
    """Without a limit of their force, grippers press jammed ropes halfway into each other and into the table."""
    env = make(render_observation=False)
    jammed = 0
    for seed in (45, 12, 21):
        start(env, seed)
        drag(env, seed, 30)
        for _ in range(15):
            before = env._target.copy()
            env._move(np.array([-1.0, -1, 0, -1, 1, 0]))
            asked = env._workspace.clip(before + np.array([[-1.0, -1, 0], [-1, 1, 0]]) * env.STEP, before)
            jammed += int(np.abs(env._target - asked).max() > 1e-3)
            assert np.abs(env._ropes.gripper_poses()[:, :2] - env._target[:, :2]).max() < 0.02
    assert jammed > 0


# ---- goals in the wrappers: of all ropes, and of one

GOALS = ("achieved_goal", "desired_goal")
# Two ropes at a size at which every rope is found in each of these frames.
SEEN = {"camera": [320, 240], "renderer": "rays", "ropes": 2, "difficulty": "near"}


def shapes_env(**options: Any) -> Any:
    return gym.make("ShapeObs/CablesShape-v0", **{**SEEN, **options})


@pytest.mark.parametrize("options", [{}, {"grippers": 1}, {"ropes": 3, "camera": "d455"}], ids=str)
def test_slot_k_has_the_goal_of_rope_k(options):
    env = ShapeGoal(shapes_env(rope="all", **options))
    ropes = options.get("ropes", 2)
    assert env.names == tuple(f"centerline{k}" for k in range(ropes))
    for seed in range(2):
        observation, info = env.reset(seed=seed)
        assert all(info[f"shape/{name}/ok"] for name in env.names)
        inner: Any = env.unwrapped
        goal = inner._goal.reshape(ropes, 20, 3)
        for _ in range(2):
            achieved, desired = (observation[key].reshape(ropes, 20, 3) for key in GOALS)
            for rope in range(ropes):
                off = np.linalg.norm(achieved[rope] - inner.truth(rope=rope), axis=1)
                assert off.mean() < 0.01
                assert np.linalg.norm(desired[rope] - goal[rope], axis=1).max() < 0.003
            observation, reward, _, _, info = env.step(np.full(env.action_space.shape or (), 0.2, np.float32))
            apart = np.linalg.norm(achieved - desired, axis=2).mean()
            assert reward == -info["goal/distance"] == pytest.approx(-apart, abs=0.01)
            assert info["goal/distance"] == pytest.approx(info["truth/mean_error"], abs=0.01)
