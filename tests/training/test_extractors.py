"""The input of a policy's network."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces


@pytest.fixture(scope="module")
def torch() -> Any:
    """Return the module; collecting the tests does not load it."""
    pytest.importorskip("stable_baselines3")
    return pytest.importorskip("torch")


def goals(size: int) -> dict[str, spaces.Space]:
    box = spaces.Box(-1.0, 1.0, (size,), np.float32)
    return {"achieved_goal": box, "desired_goal": box}


def batch(torch: Any, space: spaces.Dict, size: int = 4) -> Any:
    space.seed(0)
    samples = [space.sample() for _ in range(size)]
    return {key: torch.as_tensor(np.stack([sample[key] for sample in samples])) for key in space.spaces}


@pytest.mark.parametrize("visible", [None, 2])
def test_goal_difference(torch, visible):
    from shape_obs.training import GoalDifference

    space = spaces.Dict({"observation": spaces.Box(-1.0, 1.0, (5,), np.float32), **goals(6)})
    extractor = GoalDifference(space, visible)
    seen = batch(torch, space)
    size = visible or 6
    features = extractor(seen)
    assert features.shape == (4, extractor.features_dim) == (4, 5 + 2 * size)
    desired, achieved = seen["desired_goal"][:, :size], seen["achieved_goal"][:, :size]
    torch.testing.assert_close(features, torch.cat([seen["observation"], desired, desired - achieved], dim=1))
    hidden = {**seen, "desired_goal": seen["desired_goal"].clone(), "achieved_goal": seen["achieved_goal"].clone()}
    hidden["desired_goal"][:, size:] += 1
    hidden["achieved_goal"][:, size:] -= 1
    torch.testing.assert_close(extractor(hidden), features)


def test_image_and_goal_reads_no_achieved_goal(torch):
    from shape_obs.training import ImageAndGoal

    image = spaces.Box(0, 255, (3, 40, 48), np.uint8)
    space = spaces.Dict({"observation": image, **goals(6)})
    extractor = ImageAndGoal(space, features=8)
    seen = batch(torch, space)
    seen["observation"] = seen["observation"].float() / 255  # as policies hand images on
    features = extractor(seen)
    assert features.shape == (4, extractor.features_dim) == (4, 14)
    torch.testing.assert_close(features[:, 8:], seen["desired_goal"])
    torch.testing.assert_close(extractor({**seen, "achieved_goal": 0 * seen["achieved_goal"]}), features)
    assert not torch.allclose(extractor({**seen, "observation": 0 * seen["observation"]}), features)


class Lamp(gym.Env[Any, Any]):
    """An environment whose action should be the brightness of the image; its goal has no meaning."""

    action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
    observation_space = spaces.Dict({"observation": spaces.Box(0, 255, (3, 36, 36), np.uint8), **goals(1)})

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self._level = float(self.np_random.uniform(-1, 1))
        return self._seen(), {}

    def step(self, action: Any) -> Any:
        return self._seen(), -abs(float(action[0]) - self._level), True, False, {}

    def _seen(self) -> dict[str, Any]:
        image = np.full((3, 36, 36), 127.5 * (1 + self._level), np.uint8)
        return {"observation": image, "achieved_goal": np.zeros(1, np.float32), "desired_goal": np.zeros(1, np.float32)}


@pytest.mark.nightly
def test_a_pixel_policy_learns_what_it_sees_through_the_critic_alone(torch, tmp_path):
    from stable_baselines3 import SAC

    from shape_obs.training import ImageAndGoal, PixelPolicy

    torch.set_num_threads(1)
    model = SAC(
        PixelPolicy, Lamp(), seed=0, device="cpu", learning_rate=1e-3, batch_size=64, buffer_size=2000, gamma=0.5,
        learning_starts=100, policy_kwargs={"net_arch": [32], "features_extractor_class": ImageAndGoal},
    )  # fmt: skip
    sees = model.critic.features_extractor
    before = [value.clone() for value in sees.parameters()]
    model.learn(600)
    assert not any(torch.equal(old, new) for old, new in zip(before, sees.parameters(), strict=True))
    taught = {id(value) for group in model.actor.optimizer.param_groups for value in group["params"]}
    assert taught.isdisjoint(id(value) for value in sees.parameters()), "not by the actor's loss"

    levels = np.linspace(-0.9, 0.9, 7)
    env = Lamp()
    env.reset(seed=0)

    def answers(policy: Any) -> Any:
        found = []
        for level in levels:
            env._level = level
            found.append(policy.predict(env._seen(), deterministic=True)[0][0])
        return np.array(found)

    values = answers(model)
    assert np.abs(values - levels).mean() < 0.25
    model.save(tmp_path / "model")
    np.testing.assert_array_equal(answers(SAC.load(tmp_path / "model", device="cpu")), values)
