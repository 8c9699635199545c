"""Domain randomisation: drawn values, seeds, and what must not change."""

from __future__ import annotations

import json
import pickle
from typing import Any, cast

import cv2
import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

pytest.importorskip("mujoco")

import shape_obs_envs  # noqa: F401
from shape_obs import ShapeObservation
from shape_obs_envs.mujoco.goal_env import ShapeGoalEnv
from shape_obs_envs.mujoco.randomization import FACTORS, Randomizer
from shape_obs_envs.mujoco.scene import cast_rays

#: Environments with one object, and all of them.
SINGLE = ("Cable", "Ring", "Cloth", "Hanging")
ENVS = (*SINGLE, "Cables")
LOOKS = {"material": False}
ONLY_HAND = {"others": False, "hand": {"probability": 1.0, "latest": 2}}


def make(name: str, randomize: Any = True, **options: Any) -> ShapeGoalEnv:
    """Return the bare environment."""
    env = gym.make(f"ShapeObs/{name}-v0", **{"camera": [84, 84], "renderer": "rays", **options}, randomize=randomize)
    return cast(ShapeGoalEnv, env.unwrapped)


def reset(env: ShapeGoalEnv, seed: int) -> tuple[Any, Any]:
    """Reset without the search for a goal, which takes most of the time."""
    return env.reset(seed=seed, options={"goal": np.zeros(env._goal.size)})


def play(env: ShapeGoalEnv, seed: int, steps: int = 4) -> list[Any]:
    """Return observations of a few random steps."""
    rng = np.random.default_rng(seed)
    assert env.action_space.shape is not None
    actions = rng.uniform(-1, 1, (steps, *env.action_space.shape)).astype(np.float32)
    return [reset(env, seed)[0], *(env.step(action)[0] for action in actions)]


def same(one: list[Any], other: list[Any], *keys: str) -> bool:
    """Return whether all observations, or these parts of them, are equal."""
    return all(np.array_equal(a[key], b[key]) for a, b in zip(one, other, strict=True) for key in keys or a)


@pytest.fixture(scope="module", params=ENVS)
def name(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def env(name: str):
    env = make(name)
    yield env
    env.close()


# ---- the argument


def test_off_it_adds_and_draws_nothing(name):
    env, on = make(name, False), make(name, True)
    assert env.randomization == {}
    assert env._body.model.ngeom < on._body.model.ngeom
    assert not {"table", "hand"} & {env._body.model.texture(i).name for i in range(env._body.model.ntex)}
    assert env.shape_obs_defaults["segmentation"] != on.shape_obs_defaults["segmentation"]  # type: ignore[attr-defined]
    default = cast(ShapeGoalEnv, gym.make(f"ShapeObs/{name}-v0", camera=[84, 84], renderer="rays").unwrapped)
    assert same(play(env, 5), play(default, 5))


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ("yes", "randomize: expected True, False or a mapping of light, table"),
        ({"lights": True}, "randomize: unknown factor 'lights'; did you mean 'light'"),
        ({"hand": {"cover": 0.9}}, "randomize: hand.cover: expected a number from 0 to 0.5, got 0.9"),
        ({"camera": {"tild": 0.1}}, "unknown field 'tild'; did you mean 'tilt'"),
        ({"table": {"cell": [0.1, 0.01]}}, "table.cell: expected two sizes within 0.004 ... 0.4 m"),
        ({"others": 1}, "randomize: others: expected True or False, got 1"),
        ({"distractors": {"ropes": 5}}, "distractors.ropes: expected a number from 0 to 4, got 5"),
    ],
)
def test_bad_arguments_raise_an_error(argument, message):
    with pytest.raises(ValueError, match="randomize: ") as error:
        Randomizer(argument)
    assert message in str(error.value)


def test_rebuild_from_json_and_pickle():
    randomize = {"hand": {"probability": 1.0}, "distractors": {"most": 2}, "camera": False}
    one = gym.make("ShapeObs/Cable-v0", camera=[84, 84], renderer="rays", randomize=randomize)
    assert one.spec is not None
    two = gym.make(EnvSpec.from_json(json.dumps(json.loads(one.spec.to_json()))))
    three = pickle.loads(pickle.dumps(one.unwrapped))
    plays = [play(cast(ShapeGoalEnv, env.unwrapped), 2) for env in (one, two, three)]
    assert same(plays[0], plays[1])
    assert same(plays[0], plays[2])


# ---- the seed


def test_a_seed_gives_the_same_again_and_forgets_the_past(env, name):
    first, drawn = play(env, 4), env.randomization
    play(env, 5)
    assert env.randomization != drawn
    assert same(first, play(env, 4))
    assert env.randomization == drawn
    other = make(name)
    assert same(first, play(other, 4))
    json.dumps(drawn)
    assert list(drawn) == ["material", *(factor for factor in FACTORS if factor != "material")]


def test_one_factor_leaves_the_others_as_they_were():
    everything = make("Cable", render_observation=False)
    reset(everything, 7)
    drawn = everything.randomization
    for factor in ("light", "object", "material", "hand"):
        less = make("Cable", {factor: False}, render_observation=False)
        reset(less, 7)
        left = {key: value for key, value in drawn.items() if key != factor}
        if factor == "material":  # things lie clear of where the rope is, which has another bend
            del left["distractors"]
        assert {key: less.randomization[key] for key in left} == left


def test_looks_change_nothing_but_the_pictures(name):
    plain = make(name, {"others": False, "light": True})
    dressed = make(name, LOOKS)
    one, two = play(plain, 3), play(dressed, 3)
    assert same(one, two, "achieved_goal", "gripper")
    assert not same(one, two, "rgb")


# ---- physics


def test_a_state_is_taken_over_with_another_thickness():
    env = make("Cable", {"others": False, "material": True}, render_observation=False)
    reset(env, 0)
    state, goal = env.get_state(), env._goal_points().astype(np.float32)
    env.reset(seed=1, options={"start": state, "goal": goal})
    for _ in range(5):
        env.step(np.zeros(6, np.float32))
    chain = cast(Any, env)._chain
    assert np.abs(chain.tip_poses()[:, :2] - env._target[:, :2]).max() < 1e-3
    assert np.allclose(chain.vertices()[:, 2], chain.spec.radius)


# ---- things that lie about, and the hand


def test_distractors_hide_nothing(name):
    env = make(name, {"others": False, "distractors": {"most": 6}, "camera": True}, render_observation=False)
    model, data = env._body.model, env._body.data
    geoms = {int(model.body(f"distractor{i}_").geomadr[0]) for i in range(6)}
    things = 0
    for seed in range(6):
        play(env, seed, 8)
        things += len(env.randomization["distractors"]["things"])
        eye = data.cam_xpos[0].copy()
        rays = env._goal_points() - eye
        rays /= np.linalg.norm(rays, axis=1)[:, None]
        _, hit = cast_rays(model, data, eye, rays)
        tall = {int(model.body(f"distractor{i}_").geomadr[0]) for i in range(6) if data.mocap_pos[-6:][i][2] > 0.003}
        assert not set(hit.tolist()) & geoms & tall
    assert things > 8


def test_the_hand_comes_hides_a_part_and_goes(name):
    env = make(name, ONLY_HAND, render_observation=False)
    hidden, seen = [], []
    for seed in range(5):
        reset(env, seed)
        plan, visit = env.randomization["hand"], env._randomizer._visit
        assert visit is not None
        shown = []
        for _ in range(plan["end"] + 2):
            env.step(np.zeros(env.action_space.shape or (), np.float32))
            geom = int(env._body.model.body("hand").geomadr[0])
            shown.append(bool(env._body.model.geom_rgba[geom, 3]))
            if shown[-1]:
                hidden.append(visit.hidden(env._goal_points()))
                assert visit.hidden(env._body.landmarks()) == 0
        seen.append(sum(shown))
        assert not shown[-1]
        assert not any(shown[: plan["start"]])
    assert 0.03 <= max(hidden) <= 0.2
    assert min(seen) >= 10


# ---- distractor ropes: of the object's colour, over the object, and without any effect on it

ROPES = {"others": False, "distractors": {"most": 0, "ropes": 3}}


def geoms(env: Any, most: int = 3) -> np.ndarray:
    """Return the geoms of the distractor ropes that are shown."""
    model = env._body.model
    ids = np.concatenate([int(model.body(f"distractor_rope{i}_").geomadr[0]) + np.arange(24) for i in range(most)])
    return ids[model.geom_rgba[ids, 3] > 0]


def test_they_have_the_colour_of_the_object_and_lie_over_it():
    env: Any = make("Cable", ROPES | {"object": True}, render_observation=False)
    numbers, over = [], 0
    for seed in range(12):
        reset(env, seed)
        model, data = env._body.model, env._body.data
        drawn = env.randomization["distractors"]["ropes"]
        numbers.append(len(drawn))
        assert len(geoms(env)) == 24 * len(drawn)
        assert np.allclose(model.geom_rgba[geoms(env), :3], model.geom("link0").rgba[:3])
        json.dumps(drawn)
        eye = data.cam_xpos[0].copy()
        for step in range(3):
            truth = env.truth(100)
            rays = truth - eye
            away = np.linalg.norm(rays, axis=1)
            distance, hit = cast_rays(model, data, eye, rays / away[:, None])
            covered = np.isin(hit, geoms(env))
            over += int(covered.any())
            assert (away - distance)[covered].min(initial=1.0) > env._chain.spec.radius, "it is above, not within"
            if step == 0:
                assert covered.mean() <= 0.5
                assert not covered[[0, 1, -2, -1]].any()
            for _ in range(5):
                env.step(np.array([0.5, 1.0, 0.5, -0.5, -1.0, 0.5], np.float32))
    assert set(numbers) == {0, 1, 2, 3}
    assert over > 5


def test_they_change_neither_physics_nor_other_factors():
    plain, roped = make("Cable", {"others": False, "distractors": {"most": 0}}), make("Cable", ROPES)
    assert same(play(plain, 3), play(roped, 3), "achieved_goal", "gripper")
    few, many = make("Cable", True), make("Cable", {"distractors": {"ropes": 2}})
    reset(few, 4)
    reset(many, 4)
    drawn = many.randomization
    ropes = drawn["distractors"].pop("ropes")
    assert drawn == few.randomization
    assert len(ropes) <= 2
    assert same(play(many, 4), play(many, 4))


@pytest.mark.parametrize("name", ["Ring", "Cloth", "Hanging", "Cables"])
def test_they_are_ignored_where_the_object_is_no_single_rope_on_the_table(name):
    env = make(name, ROPES, render_observation=False)
    reset(env, 0)
    assert "ropes" not in env.randomization["distractors"]
    assert len(geoms(env)) == 0


# ---- images: compared with the truth, and with what a detector finds


@pytest.mark.parametrize("name", ENVS)
@pytest.mark.parametrize("camera", [[84, 84], "rl"])
def test_the_workspace_stays_in_view(name, camera):
    strong = {"others": False, "camera": {"tilt": 0.2, "turn": 0.4, "aim": 0.03, "roll": 0.1}}
    env = make(name, strong, camera=camera, render_observation=False)
    poses = []
    corners = np.array(np.meshgrid(*zip(*env.REACH, strict=True))).reshape(3, -1).T
    for seed in range(20):
        play(env, seed, 0)
        model = env.camera_model
        pixels, size = model.project_from_base(corners), (model.intrinsics.width, model.intrinsics.height)
        assert pixels.min() > -0.5
        assert (pixels < np.array(size) - 0.5).all()
        assert model.transform_camera_to_base is not None
        poses.append(model.transform_camera_to_base)
        aim = env.randomization["camera"]["aim"]
        assert np.allclose(model.project_from_base(np.array([aim])), (np.array(size) - 1) / 2, atol=1e-6)
    assert np.ptp(np.array(poses)[:, 2, 3]) > 0.03


# ---- what a detector finds in them


@pytest.mark.parametrize("name", SINGLE)
def test_the_wrapper_keeps_working(name):
    raw = make(name, camera="rl", renderer="auto")
    env, goal = ShapeObservation(raw), raw._goal_points().astype(np.float32)
    ok, errors = [], []
    for seed in range(2):
        held = np.random.default_rng(seed).uniform(-1, 1, (3, *(raw.action_space.shape or ()))).astype(np.float32)
        env.reset(seed=seed, options={"goal": goal})
        for step in range(20):
            *_, info = env.step(held[step // 8])
            ok.append(info["shape/ok"])
            assert env.detection is not None
            points = env.detection.shapes[0].points3d
            if ok[-1] and points is not None and getattr(raw, "unfolded", True):
                errors.append(np.linalg.norm(raw.camera_model.to_base(points) - raw.truth(), axis=1).mean())  # type: ignore[attr-defined]
    assert np.mean(ok) > 0.9
    assert 1000 * np.mean(errors) < (12 if name == "Cloth" else 8)


@pytest.mark.parametrize("name", ENVS)
def test_the_rule_of_colours_finds_the_object_and_nothing_else(name):
    env = make(name, camera="rl")
    rule = env.shape_obs_defaults["segmentation"]  # type: ignore[attr-defined]
    low, high = np.array(rule["low"], np.uint8), np.array(rule["high"], np.uint8)
    for seed in range(3):
        observation = play(env, seed, 1)[-1]
        mask = cv2.inRange(cv2.cvtColor(observation["rgb"], cv2.COLOR_RGB2HSV), low, high) > 0
        camera = env.camera_model
        v, u = np.nonzero(mask)
        found = camera.to_base(camera.intrinsics.deproject(np.stack([u, v], axis=1), observation["depth"][mask] / 1000))
        sizes: dict[str, tuple[Any, ...]] = {"Cloth": (40, 80), "Cables": (300, "world", "tips", False, "all")}
        true = env.truth(*sizes.get(name, (300,)))  # type: ignore[attr-defined]
        away = np.sqrt(((found[:, None] - true) ** 2).sum(axis=2)).min(axis=1)
        assert away.max() < {"Cable": 0.014, "Ring": 0.03, "Cloth": 0.012, "Hanging": 0.014, "Cables": 0.013}[name], (
            seed
        )
        pixels = np.rint(camera.project_from_base(true)).astype(int)
        around = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3)))
        assert around[pixels[:, 1], pixels[:, 0]].mean() > 0.97, seed
