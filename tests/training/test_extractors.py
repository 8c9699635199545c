"""The input of a policy's network."""

from __future__ import annotations

from typing import Any

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
