"""Environment specs that were saved under an old module name still make the environment."""

from __future__ import annotations

from dataclasses import replace

import gymnasium as gym
import pytest
from gymnasium.envs.registration import EnvSpec, load_env_creator

import shape_obs_envs  # noqa: F401 - registers the ids


def test_a_saved_spec_with_the_old_entry_point_makes_the_environment() -> None:
    spec = gym.spec("ShapeObs/D455-v0")
    assert spec.entry_point == "shape_obs_envs.real:D455Env"
    saved = replace(spec, entry_point="shape_obs_envs.cell:D455Env", kwargs={"source": "d455:1"}).to_json()
    env = gym.make(EnvSpec.from_json(saved))
    assert type(env.unwrapped) is load_env_creator("shape_obs_envs.real:D455Env")
    env.close()


def test_an_unknown_name_of_an_old_module_is_an_error() -> None:
    from importlib import import_module

    with pytest.raises(AttributeError, match="Nothing"):
        import_module("shape_obs_envs.cell").Nothing  # noqa: B018
