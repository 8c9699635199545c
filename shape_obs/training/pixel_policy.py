"""PixelPolicy: SAC from images, whose actor looks through the critic's network."""

from __future__ import annotations

from typing import Any

import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.type_aliases import Schedule
from stable_baselines3.sac.policies import MultiInputPolicy


class PixelPolicy(MultiInputPolicy):
    """SAC's policy with one feature extractor, which learns from the critic's loss alone.

    With an extractor of its own, learning from the actor's loss, an actor that sees images can go blind: after a
    training its convolutions were dead, and it did the same whatever it saw. Stable-Baselines3's
    ``share_features_extractor`` lets the actor's loss alone teach it. What is done here is that of Yarats et al.,
    "Improving Sample Efficiency in Model-Free Reinforcement Learning from Images" (AAAI 2021), without its decoder.

    Args:
        arguments: Those of ``MultiInputPolicy``, but ``share_features_extractor``.
    """

    def _build(self, lr_schedule: Schedule) -> None:
        super()._build(lr_schedule)
        self.actor.features_extractor = _Detached(self.critic.features_extractor)
        learns = [value for name, value in self.actor.named_parameters() if not name.startswith("features_extractor")]
        rate: dict[str, Any] = {"lr": lr_schedule(1)}
        self.actor.optimizer = self.optimizer_class(learns, **rate, **self.optimizer_kwargs)


class _Detached(BaseFeaturesExtractor):
    """Another extractor, which is looked through and not taught."""

    def __init__(self, extractor: BaseFeaturesExtractor) -> None:
        super().__init__(extractor._observation_space, extractor.features_dim)
        self.extractor = extractor

    def forward(self, observations: Any) -> Any:
        with torch.no_grad():
            return self.extractor(observations)
