"""Stable-Baselines3 trains on the wrapped env; hindsight relabels with the wrapper's own goals and reward."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest


def test_hindsight_replay_relabels_with_what_the_camera_saw():
    pytest.importorskip("mujoco")
    pytest.importorskip("stable_baselines3")
    import stable_baselines3 as sb3
    import torch
    from stable_baselines3.common.env_util import make_vec_env

    import shape_obs_envs  # noqa: F401

    torch.set_num_threads(1)
    envs = make_vec_env("ShapeObs/CableShape-v0", n_envs=2, env_kwargs={"renderer": "rays", "camera": [84, 84]}, seed=0)
    model = sb3.SAC(
        "MultiInputPolicy", envs, replay_buffer_class=sb3.HerReplayBuffer, learning_starts=190, batch_size=16,
        policy_kwargs={"net_arch": [16]}, seed=0, device="cpu",
    )  # fmt: skip
    model.learn(200)
    batch: Any = model.replay_buffer.sample(64)  # type: ignore[union-attr]
    seen, wanted = (batch.next_observations[key].numpy() for key in ("achieved_goal", "desired_goal"))
    by_hand = -np.linalg.norm((seen - wanted).reshape(64, 20, 3), axis=2).mean(axis=1)
    np.testing.assert_allclose(batch.rewards.numpy().ravel(), by_hand, atol=1e-5)
    goals = {goal.tobytes() for goal in wanted}
    assert len(goals) > 4  # two envs have two or four goals; the others are relabelled
    assert all(np.isfinite(value.numpy()).all() for value in batch.observations.values())
