"""ShapeObservation over a drawn rope: layouts, arguments, camera, anchors."""

from __future__ import annotations

from typing import Any, cast

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from rope_env import BLUE, INTRINSICS, PixelEnv, RopeEnv, run, walk, wrapped

from shape_obs import CameraModel, Centerline, HSVRange, ShapeObservation, SpecError
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
        class Renamed(gym.ObservationWrapper[Any, Any, Any]):
            def __init__(self, env: gym.Env[Any, Any]) -> None:
                super().__init__(env)
                inner = cast(spaces.Dict, env.observation_space)
                self.observation_space = spaces.Dict(
                    {"colour": inner["rgb"], "z": inner["depth"], "shape": inner["hand"]}
                )

            def observation(self, observation: Any) -> Any:
                return {"colour": observation["rgb"], "z": observation["depth"], "shape": observation["hand"]}

        same = wrapped(Renamed(RopeEnv()), rgb_key="colour", depth_key="z")
        for a, b in zip(run(same), run(wrapped()), strict=True):
            np.testing.assert_array_equal(a[0], b[0])
        with pytest.raises(ValueError, match=r"rgb_key 'rgb' is not in the observation. Known: colour, shape, z"):
            wrapped(Renamed(RopeEnv()))
        with pytest.raises(ValueError, match=r"keep: 'shape' is the key that this wrapper uses for the shape; rename"):
            wrapped(Renamed(RopeEnv()), rgb_key="colour", keep=["shape"])


class TestArguments:
    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({"rgb_key": "rbg"}, "rgb_key 'rbg' is not in the observation; did you mean 'rgb'"),
            ({"depth_key": "dpeth"}, "depth_key 'dpeth' is not in the observation; did you mean 'depth'"),
            ({"keep": ["hnad"]}, "keep: no key 'hnad' in the observation; did you mean 'hand'"),
            ({"featurs": ["ok"]}, "ShapeObservation: unknown argument 'featurs'; did you mean 'features'"),
            ({"on_mising": "hold"}, "ShapeObservation: unknown argument 'on_mising'; did you mean 'on_missing'"),
            ({"features": ["point3d"]}, "feature: unknown kind 'point3d'; did you mean 'points3d'"),
            ({"shapes": ["centreline"]}, "configuration: unknown kind 'centreline'; did you mean 'centerline'"),
            ({"on_missing": "nan"}, "on_missing='nan' would put NaN into observations; choose another policy, or use"),
            ({"shapes": [{"kind": "centerline", "count": "all"}]}, "count='all' has no fixed number of slots"),
            ({"on_invalid": "nan"}, "on_invalid='nan' would put NaN into observations"),
            ({"camera": {"intrinsics": INTRINSICS.to_dict(), "transform_camera_to_base": [[1, 2], [3, 4]]}}, "rigid"),
            ({"camera": {"widht": 3}}, "Intrinsics: unknown field 'widht'; did you mean 'width'"),
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

    def test_specs_and_mappings_do_the_same_and_are_recorded_as_json(self):
        as_specs = ShapeObservation(
            RopeEnv(), [Centerline(n=6)], HSVRange((100, 120, 60), (125, 255, 255)), [Points3D()],
            camera=CameraModel(INTRINSICS, np.eye(4)), workspace=np.array([[-1, -1, -1], [1, 1, 1]]),  # type: ignore[arg-type]
        )  # fmt: skip
        recorded = as_specs._saved_kwargs
        again = ShapeObservation(RopeEnv(), **recorded)
        for a, b in zip(run(as_specs), run(again), strict=True):
            np.testing.assert_array_equal(a[0], b[0])
        assert again._saved_kwargs == recorded


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
        env = wrapped(camera=INTRINSICS.to_dict(), anchor=[200, 60])
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
