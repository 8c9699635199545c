"""What a policy's network reads of an observation, as feature extractors of Stable-Baselines3."""

from __future__ import annotations

import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, NatureCNN

Observations = dict[str, torch.Tensor]


class GoalDifference(BaseFeaturesExtractor):
    """(B, M + 2 V): what is seen, what is desired, and how far apart they are.

    The difference spares the network from having to learn to subtract. Of the two goals the first ``visible`` numbers
    are read.

    Args:
        observation_space: Of ``observation`` (M,), ``achieved_goal`` and ``desired_goal``.
        visible: V; None for all. ``PointReward`` and ``Shuffled`` tell it.
    """

    def __init__(self, observation_space: spaces.Dict, visible: int | None = None) -> None:
        size = visible or spaces.flatdim(observation_space["desired_goal"])
        super().__init__(observation_space, spaces.flatdim(observation_space["observation"]) + 2 * size)
        self._visible = size

    def forward(self, observations: Observations) -> torch.Tensor:
        """(B, M + 2 V)."""
        desired = observations["desired_goal"][:, : self._visible]
        achieved = observations["achieved_goal"][:, : self._visible]
        return torch.cat([observations["observation"], desired, desired - achieved], dim=1)


class ImageAndGoal(BaseFeaturesExtractor):
    """(B, ``features`` + D): the image through the network of Mnih et al. (Nature 2015), and the desired goal (B, D).

    What is made of the image lies in -1 ... 1 (a linear layer, layer normalisation, tanh), as a normalised goal does.
    ``achieved_goal`` is not read: an image is all that is known of the present shape.

    Args:
        observation_space: Of ``observation``, an image (C, H, W) uint8, and the goals.
        features: How many numbers are made of the image.
    """

    def __init__(self, observation_space: spaces.Dict, features: int = 128) -> None:
        super().__init__(observation_space, features + spaces.flatdim(observation_space["desired_goal"]))
        image = observation_space["observation"]
        assert isinstance(image, spaces.Box)
        network = NatureCNN(image, features)
        self._image = torch.nn.Sequential(network.cnn, network.linear[0], torch.nn.LayerNorm(features), torch.nn.Tanh())

    def forward(self, observations: Observations) -> torch.Tensor:
        """(B, ``features`` + D)."""
        return torch.cat([self._image(observations["observation"]), observations["desired_goal"]], dim=1)
