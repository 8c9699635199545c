"""ShapeObservation over a drawn rope and a sheet: layouts, arguments, camera, anchors, lost shapes, state, copies."""

from __future__ import annotations

import copy
import json
import pickle
import warnings
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import rope_env
from env_checks import check_both
from goal_envs import RED, FlatGoalEnv
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import Autoreset, OrderEnforcing, TimeLimit
from hypothesis import given, settings
from hypothesis import strategies as st
from rope_env import BLUE, INTRINSICS, PixelEnv, RopeEnv, run, walk, wrapped

from shape_obs import Centerline, ShapeDetector, ShapeObservation, SpecError
from shape_obs.features import Points3D


class TestLayout:
    def test_normalised_pixels_are_the_default_over_a_plain_image(self):
        env = wrapped(PixelEnv(RopeEnv()))
        observation, _ = env.reset(seed=1)
        assert env.observation_space == spaces.Box(-1, 1, (40,), np.float32)
        true = 2 * (env.unwrapped.true_points() + 0.5) / (160, 120) - 1  # type: ignore[attr-defined]
        np.testing.assert_allclose(observation.reshape(-1, 2), true, atol=0.03)

    def test_shapes_and_features_fill_the_vector_in_order(self):
        shapes = [Centerline(n=4), {"kind": "centerline", "n": 6, "name": "b"}]
        env = wrapped(shapes=shapes, features=["points2d", "valid", "ok", "age"])
        observation, _ = env.reset(seed=0)
        assert observation.shape == (4 * 3 + 2 + 6 * 3 + 2,)
        np.testing.assert_array_equal(observation[8:14], [1, 1, 1, 1, 1, 0])

    def test_with_keep_the_observation_is_a_dict(self):
        env = wrapped(keep=["hand", "phase", "deep", "rgb"])
        assert isinstance(env.observation_space, spaces.Dict)
        assert set(env.observation_space) == {"shape", "hand", "phase", "deep", "rgb"}
        for observation, *_ in walk(env):
            assert env.observation_space.contains(observation)
            assert observation["deep"]["row"][0] == pytest.approx(env.unwrapped.row)  # type: ignore[attr-defined]

    def test_other_keys(self):
        def renamed() -> gym.Env[Any, Any]:
            inner = RopeEnv()
            named = {"colour": "rgb", "z": "depth", "shape": "hand"}
            space = spaces.Dict({mine: inner.observation_space[its] for mine, its in named.items()})  # type: ignore[index]
            take = lambda seen: {mine: seen[its] for mine, its in named.items()}  # noqa: E731
            return gym.wrappers.TransformObservation(inner, take, space)

        same = wrapped(renamed(), rgb_key="colour", depth_key="z")
        for a, b in zip(run(same), run(wrapped()), strict=True):
            np.testing.assert_array_equal(a[0], b[0])
        with pytest.raises(ValueError, match=r"rgb_key 'rgb' is not in the observation. Known: colour, shape, z"):
            wrapped(renamed())
        with pytest.raises(ValueError, match=r"keep: 'shape' is the key that this wrapper uses for the shape; rename"):
            wrapped(renamed(), rgb_key="colour", keep=["shape"])


def repeated(env: gym.Env[Any, Any], count: int) -> gym.Env[Any, Any]:
    if not hasattr(gym.wrappers, "RepeatAction"):
        pytest.skip("this Gymnasium has no RepeatAction")
    return gym.wrappers.RepeatAction(env, count)


class Twice(gym.Wrapper[Any, Any, Any, Any]):
    """A frame skip of a user's own."""

    def step(self, action: Any) -> Any:
        self.env.step(action)
        return self.env.step(action)


class Timed(gym.Wrapper[Any, Any, Any, Any]):
    """It knows how long its steps are."""

    dt = 0.5


class ResetWithin(gym.Wrapper[Any, Any, Any, Any]):
    """Reset in the step that ends an episode."""

    def step(self, action: Any) -> Any:
        observation, reward, terminated, truncated, info = self.env.step(action)
        if truncated:
            observation, info = self.env.reset()
        return observation, reward, terminated, truncated, info


class TestArguments:
    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({"rgb_key": "rbg"}, "rgb_key 'rbg' is not in the observation; did you mean 'rgb'"),
            ({"keep": ["hnad"]}, "keep: no key 'hnad' in the observation; did you mean 'hand'"),
            ({"featurs": ["ok"]}, "ShapeObservation: unknown argument 'featurs'; did you mean 'features'"),
            ({"features": ["point3d"]}, "feature: unknown kind 'point3d'; did you mean 'points3d'"),
            ({"on_missing": "nan"}, "on_missing='nan' would put NaN into observations; choose another policy, or use"),
            ({"shapes": [{"kind": "centerline", "count": "all"}]}, "count='all' has no fixed number of slots"),
            ({"on_invalid": "nan"}, "on_invalid='nan' would put NaN into observations"),
            ({"camera": {"intrinsics": INTRINSICS.to_dict(), "transform_camera_to_base": [[1, 2], [3, 4]]}}, "rigid"),
        ],
    )
    def test_wrong_ones_raise_an_error(self, arguments, message):
        with pytest.raises(ValueError, match=message):
            wrapped(**arguments)

    def test_over_an_image_there_is_nothing_to_keep_and_no_depth(self):
        with pytest.raises(ValueError, match=r"keep=\['hand'\] needs a Dict observation, got Box"):
            wrapped(PixelEnv(RopeEnv()), keep=["hand"])
        with pytest.raises(ValueError, match=r"no 'depth', but the config needs it: feature 'points3d'.*pass"):
            wrapped(PixelEnv(RopeEnv()), features=["points3d"])

    def test_state_observations_are_refused_with_a_hint(self):
        with pytest.raises(ValueError, match=r"must be an RGB image, .* e.g. with"):
            ShapeObservation(gym.make("CartPole-v1"))

    def test_a_missing_key_of_an_observation_raises_an_error(self):
        inner = RopeEnv()
        env = wrapped(inner)
        whole = inner._observe
        inner._observe = lambda: {key: value for key, value in whole().items() if key != "depth"}  # type: ignore[method-assign]
        with pytest.raises(KeyError, match=r"the observation has no 'depth', but its space does; keys: \['deep'"):
            env.reset(seed=0)

    def test_what_the_env_publishes_stands_in_for_any_argument(self):
        class Publishing(RopeEnv):
            shape_obs_defaults = {  # noqa: RUF012
                "segmentation": BLUE, "features": ["points2d"], "keep": ["hand"], "shapes": ["centerline"],
                "on_missing": "truncate", "camera": INTRINSICS.to_dict(), "rgb_key": "rgb", "dt": 0.25,
            }  # fmt: skip

        env = ShapeObservation(Publishing())
        assert set(env.observation_space) == {"shape", "hand"}  # type: ignore[arg-type]
        assert (env.detector.config.on_missing, env.detector.config.dt) == ("truncate", 0.25)
        mine = ShapeObservation(Publishing(), features=["ok"], keep=[], on_missing="hold")
        assert mine.observation_space == spaces.Box(0, 1, (1,), np.float32)
        assert mine.detector.config.on_missing == "hold"
        Publishing.shape_obs_defaults = {"shaeps": []}
        with pytest.raises(SpecError, match="unknown argument 'shaeps'; did you mean 'shapes'"):
            ShapeObservation(Publishing())


class TestCamera:
    def test_the_pose_is_read_again_at_each_reset(self):
        env = wrapped(features=[{"kind": "points3d", "frame": "base"}], workspace=((-5, -5, -5), (5, 5, 5)))
        heights = set()
        for seed in range(4):
            observation, _ = env.reset(seed=seed)
            height = env.unwrapped.height  # type: ignore[attr-defined]
            np.testing.assert_allclose(observation.reshape(-1, 3)[:, 2], height - 0.5, atol=1e-3)
            heights.add(height)
        assert len(heights) == 4

    def test_bare_intrinsics_do_for_the_camera_frame(self):
        opencv = wrapped(camera=(INTRINSICS.matrix, None), anchor=[200, 60])
        recorded = json.loads(json.dumps(opencv._saved_kwargs))  # type: ignore[attr-defined]
        plain = wrapped(camera=INTRINSICS.to_dict(), anchor=[200, 60])
        for env in (plain, opencv, ShapeObservation(RopeEnv(), **recorded)):
            np.testing.assert_allclose(env.reset(seed=0)[0].reshape(-1, 3)[:, 2], 0.5, atol=1e-3)
        with pytest.raises(ValueError, match="in frame 'base' needs transform_camera_to_base"):
            wrapped(camera=INTRINSICS, features=[Points3D(frame="base")])

    def test_the_envs_first_anchor_holds_point_zero(self):
        observation, _ = wrapped(features=["points2d"]).reset(seed=0)
        assert observation[0] > 120
        observation, _ = wrapped(features=["points2d"], anchor=(0, 60)).reset(seed=0)
        assert observation[0] < 40

    def test_the_frame_of_the_anchor_moves_with_it(self):
        env = wrapped(shapes=[{"kind": "centerline", "ends": "tips"}], features=[Points3D(frame="anchor")])
        for observation, *_ in run(env):
            np.testing.assert_allclose(observation[:3], 0, atol=0.006)


def test_corners_stay_on_the_material_while_a_sheet_turns_half_round():
    shapes = [{"kind": "surface", "rows": 3, "cols": 5, "ends": "tips"}, {"kind": "contour", "n": 16}]
    env = ShapeObservation(FlatGoalEnv("surface", tilt=0, goals=False), shapes, RED, ["points3d", "valid"])
    check_env(env, skip_render_check=True)
    observation, _ = env.reset(seed=3)
    assert observation.shape == (4 * (15 + 16),)
    inner: Any = env.unwrapped
    inner.end = inner.start + (0.0, 0.0, 3.2, 0.0, 0.0)
    for _ in range(32):
        _, _, _, _, info = env.step(np.full(1, 0.32, np.float32))
        assert [info[f"shape/{name}ok"] for name in ("", "surface/", "contour/")] == [True] * 3
        assert env.detection is not None
        corners = inner.camera_model.project_from_base(inner.material(inner.state(), [0, 1, 1, 0], [0, 0, 1, 1]))
        np.testing.assert_allclose(env.detection["surface"].pixels[[0, 4, 14, 10]], corners, atol=1.5)
    assert inner.way == 1


@pytest.mark.parametrize(
    "arguments", [{"keep": ["hand", "phase"]}, {"features": ["points2d", "ok", "age", "sigma", "new"]}]
)
def test_both_checkers_pass(arguments):
    check_both(wrapped(**arguments))


class TestInfo:
    def test_it_gains_flat_scalars(self):
        for _, _, _, _, info in run(wrapped(shapes=[Centerline(name="rope")])):
            kinds = {key: type(value) for key, value in info.items() if key.startswith("shape/")}
            assert kinds == {
                "shape/ok": bool, "shape/age": float, "shape/rope/ok": bool,
                "shape/rope/valid_fraction": float, "shape/rope/quality": float, "shape/rope/sigma": float,
                "shape/rope/track_id": int,
            }  # fmt: skip
            assert info["shape/ok"]
            assert info["shape/rope/valid_fraction"] == 1
            assert 0 < info["shape/rope/quality"] <= 1
            assert 0 < info["shape/rope/sigma"] < 0.01
            assert info["shape/rope/track_id"] == 1

    def test_it_reports_lost_continuity_and_how_sure_the_points_are(self):
        # With order="image" no track outlives a loss.
        env = wrapped(RopeEnv(hide=[2, 3, 4, 5]), order="image", features=["sigma", "new"], max_age=0.25)
        for _ in range(2):  # a reset begins again at 1, so that equal seeds give equal infos
            steps = run(env, steps=7)
            infos = [step[4] for step in steps]
            assert [info["shape/centerline/track_id"] for info in infos] == [1, 1, 1, 1, 1, 1, 2, 2]
            assert [step[0][20] for step in steps] == [1, 0, 0, 0, 0, 0, 1, 0]
            sigma = [info["shape/centerline/sigma"] for info in infos]
            assert sigma[1] < 0.01 < sigma[2] < sigma[3] < sigma[4] < sigma[5] < 1
            assert sigma[6] == pytest.approx(sigma[0], rel=0.2)
            for step in steps:
                assert env.observation_space.contains(step[0])
                assert step[0][:20].max() == np.float32(step[4]["shape/centerline/sigma"])

    def test_stamps_of_the_env_win_over_its_time_step(self):
        class Stamped(RopeEnv):
            def step(self, action: Any) -> Any:
                *rest, info = super().step(action)
                return (*rest, {**info, "stamp": 3.0 * self.steps})

        infos = [step[4] for step in run(wrapped(Stamped(hide=[2, 3])), steps=3)]
        assert [info["shape/age"] for info in infos] == pytest.approx([0, 0, 3.0, 6.0])
        assert [info["shape/ok"] for info in infos] == [True, True, False, False]

    @pytest.mark.parametrize(
        ("wrap", "given", "dt"),
        [
            (lambda env: env, {}, 0.1), (lambda env: env, {"dt": 0.2}, 0.2), (Twice, {"dt": 0.3}, 0.3),
            (lambda env: env, {"dt": 0.05}, 0.05),
            (lambda env: repeated(TimeLimit(OrderEnforcing(env), 99), 3), {}, 0.3), (Twice, {}, 0.2),
            (lambda env: Twice(repeated(env, 2)), {}, 0.4), (lambda env: Timed(Twice(env)), {}, 0.5),
            (lambda env: Twice(Timed(env)), {}, 1.0),
        ],
    )  # fmt: skip
    def test_time_goes_on_by_what_a_step_lasts_under_any_wrapper(self, wrap, given, dt):
        env = wrapped(wrap(RopeEnv(hide=range(1, 99), length=99)), **given)
        assert [step[4]["shape/age"] for step in run(env, steps=3)] == pytest.approx([0, dt, 2 * dt, 3 * dt])
        assert env.dt == pytest.approx(dt)
        assert "step" not in vars(env.unwrapped)

    def test_a_time_step_that_nothing_shows_is_said_once(self, monkeypatch):
        monkeypatch.setattr(RopeEnv, "metadata", {})
        with pytest.warns(UserWarning, match="how long a step is") as caught:
            _ = [run(env, steps=3) for env in (wrapped(), wrapped(dt=0.1))]
        assert [each.filename for each in caught] == [rope_env.__file__]

    @pytest.mark.parametrize("fps", ["30", -30, [30], np.inf])
    def test_a_rate_that_is_no_positive_number_is_refused(self, monkeypatch, fps):
        monkeypatch.setattr(RopeEnv, "metadata", {"render_fps": fps})
        with pytest.raises(ValueError, match=r"publishes metadata\['render_fps'\]=.*: expected frames per second"):
            wrapped()

    @pytest.mark.parametrize(
        ("given", "count"),
        [
            ({"dt": 33.3}, 1), ({"dt": 30}, 1), ({"max_age": 500}, 1), ({"max_speed": 5000}, 1),
            ({"dt": 2, "max_age": 60, "max_speed": 100}, 0), ({"max_speed": None}, 0),
        ],
    )  # fmt: skip
    def test_times_and_speeds_in_another_unit_are_said_once(self, given, count):
        for make in (ShapeDetector, wrapped):
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                make(**given)
            assert [str(each.message).partition(":")[0] for each in caught] == count * list(given)

    @pytest.mark.parametrize("wrap", [Autoreset, ResetWithin])
    def test_an_env_that_resets_itself_begins_a_track_and_a_time(self, wrap):
        env = wrapped(wrap(RopeEnv(hide=[2], length=2)), features=["new"])
        seen = [(env.detection.stamp, bool(step[0][0])) for step in walk(env, steps=5) if env.detection is not None]
        episode = [(0, True), (0.1, False), (0.2, False)]
        assert seen == (2 * episode if wrap is Autoreset else 3 * episode[:2])


class TestMissing:
    def test_hold_repeats_the_observation_and_features_report_it(self):
        env = wrapped(RopeEnv(hide=range(2, 9)), features=["points3d", "ok", "age", "valid"], max_age=0.25)
        steps = [step[0] for step in run(env, steps=6)]
        for k in range(2, 7):
            np.testing.assert_array_equal(steps[k][:60], steps[1][:60])
            assert not steps[k][62:].any()
        assert [s[60] for s in steps] == [1, 1, 1, 1, 0, 0, 0]
        assert [s[61] for s in steps] == pytest.approx([0, 0, 0.1, 0.2, 0.25, 0.25, 0.25])

    def test_with_nothing_to_hold_it_is_the_centre_of_the_box(self):
        env = wrapped(RopeEnv(hide=[0]))
        observation, info = env.reset(seed=0)
        box = env.observation_space
        assert isinstance(box, spaces.Box)
        np.testing.assert_allclose(observation, (box.low + box.high) / 2, atol=1e-6)
        assert info["shape/ok"] is False

    def test_truncate_ends_the_episode(self):
        steps = run(wrapped(RopeEnv(hide=[3]), on_missing="truncate"), steps=3)
        assert [step[3] for step in steps] == [False, False, False, True]
        assert not any(step[3] for step in run(wrapped(RopeEnv(hide=[3])), steps=3))


class TestState:
    def test_reset_clears_it(self):
        used, fresh = wrapped(RopeEnv(hide=[0], length=50)), wrapped(RopeEnv(hide=[0]))
        run(used, seed=3, steps=20)
        used.reset(seed=0)
        assert used.detection is not None
        assert used.detection.stamp == 0
        for a, b in zip(run(used, seed=0), run(fresh, seed=0), strict=True):
            np.testing.assert_array_equal(a[0], b[0])
            assert a[4]["shape/age"] == b[4]["shape/age"]

    @pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
    def test_a_copy_goes_on_like_the_original(self, copied):
        env = wrapped(RopeEnv(hide=[4]), features=["points3d", "ok", "age"])
        run(env, steps=3)
        twin = copied(env)
        for _ in range(3):
            mine, its = env.step(np.ones(1, np.float32)), twin.step(np.ones(1, np.float32))
            np.testing.assert_array_equal(mine[0], its[0])
            assert mine[1:4] == its[1:4]


@settings(max_examples=15)
@given(
    seed=st.integers(0, 2**16),
    noise=st.sampled_from(["colour", "blue", "depth", "blocks"]),
    frame=st.sampled_from(["camera", "base", "anchor"]),
    on_missing=st.sampled_from(["hold", "truncate"]),
    on_invalid=st.sampled_from(["interpolate", "hold"]),
)
def test_observations_of_any_images_are_finite_and_in_their_space(seed, noise, frame, on_missing, on_invalid):
    rng = np.random.default_rng(seed)
    inner = RopeEnv()
    clean = inner._observe

    def spoilt() -> dict[str, Any]:
        observation = clean()
        rgb, depth = observation["rgb"], observation["depth"]
        if noise == "colour":
            rgb[:] = rng.integers(0, 256, rgb.shape)
        elif noise == "blue":
            rgb[rng.uniform(size=depth.shape) < rng.uniform()] = (30, 60, 200)
        elif noise == "depth":
            depth[:] = rng.choice(np.array([0, np.nan, np.inf, -1, 1e30, 0.5], np.float32), depth.shape)
        else:
            for _ in range(rng.integers(1, 12)):
                u, v = rng.integers(0, 160), rng.integers(0, 120)
                rgb[v : v + 30, u : u + 30] = (30, 60, 200) if rng.integers(2) else (150, 150, 150)
        return observation

    inner._observe = spoilt  # type: ignore[method-assign]
    features = ["points2d", "points2d_normalized", {"kind": "points3d", "frame": frame}, "ok", "age", "valid"]
    env = wrapped(inner, features=features, on_missing=on_missing, on_invalid=on_invalid, max_age=0.15, keep=["phase"])
    outside = False
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for observation, *_ in walk(env, seed, 3):
            assert env.observation_space.contains(observation)
            assert np.isfinite(observation["shape"]).all()
            assert env.detection is not None
            shape = env.detection["centerline"]
            off = (shape.pixels < -2).any(axis=1) | (shape.pixels > (161, 121)).any(axis=1)
            outside |= bool(off.any())
            assert not (shape.visible | shape.valid)[off].any()
    # The hidden end of a long shape may lie outside the image: this alone gives a warning, that it is clipped.
    assert all("values lie outside their bounds and are clipped" in str(each.message) for each in caught)
    assert outside or not caught
