"""Extract the features of an observation that a network of Stable-Baselines3 reads."""

from __future__ import annotations

import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, NatureCNN

Observations = dict[str, torch.Tensor]


class GoalDifference(BaseFeaturesExtractor):
    """Concatenate observation, desired goal, and the difference of the two goals: shape ``(B, M + 2 V)``.

    The difference saves the network from learning to subtract. Only the first ``visible`` numbers of the goals are
    read.

    Args:
        observation_space: Space with ``observation`` ``(M,)``, ``achieved_goal`` and ``desired_goal``.
        visible: V; None for all numbers. ``PointReward`` and ``Shuffled`` have an attribute with this value.
    """

    def __init__(self, observation_space: spaces.Dict, visible: int | None = None) -> None:
        size = visible or spaces.flatdim(observation_space["desired_goal"])
        super().__init__(observation_space, spaces.flatdim(observation_space["observation"]) + 2 * size)
        self._visible = size

    def forward(self, observations: Observations) -> torch.Tensor:
        """Return features of shape ``(B, M + 2 V)``."""
        desired = observations["desired_goal"][:, : self._visible]
        achieved = observations["achieved_goal"][:, : self._visible]
        return torch.cat([observations["observation"], desired, desired - achieved], dim=1)


class ImageAndGoal(BaseFeaturesExtractor):
    """Concatenate features of an image with the desired goal ``(B, D)``: shape ``(B, features + D)``.

    The image goes through the network of Mnih et al. (Nature 2015), a linear layer, layer normalisation and tanh, so
    that its features lie in -1 ... 1 like a normalised goal. ``achieved_goal`` is not read, since it comes from the
    simulator.

    Args:
        observation_space: Space with ``observation``, an image ``(C, H, W)`` uint8, and the goals.
        features: Number of features of the image.
    """

    def __init__(self, observation_space: spaces.Dict, features: int = 128) -> None:
        super().__init__(observation_space, features + spaces.flatdim(observation_space["desired_goal"]))
        image = observation_space["observation"]
        assert isinstance(image, spaces.Box)
        network = NatureCNN(image, features)
        self._image = torch.nn.Sequential(network.cnn, network.linear[0], torch.nn.LayerNorm(features), torch.nn.Tanh())

    def forward(self, observations: Observations) -> torch.Tensor:
        """Return features of shape ``(B, features + D)``."""
        return torch.cat([self._image(observations["observation"]), observations["desired_goal"]], dim=1)
