"""Train SAC from images, with an actor that uses the convolutions of the critic."""

from __future__ import annotations

from typing import Any

import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.type_aliases import Schedule
from stable_baselines3.sac.policies import MultiInputPolicy


class PixelPolicy(MultiInputPolicy):
    """SAC's policy with a single feature extractor, which learns only from the critic's loss.

    If the actor has its own extractor and trains it with its own loss, the convolutions can die, and the actions no
    longer depend on the image. With ``share_features_extractor`` of Stable-Baselines3, the extractor learns only from
    the actor's loss. This policy follows Yarats et al., "Improving Sample Efficiency in Model-Free Reinforcement
    Learning from Images" (AAAI 2021), without the decoder.

    Args:
        arguments: Arguments of ``MultiInputPolicy``, except ``share_features_extractor``.
    """

    def _build(self, lr_schedule: Schedule) -> None:
        super()._build(lr_schedule)
        self.actor.features_extractor = _Detached(self.critic.features_extractor)
        learns = [value for name, value in self.actor.named_parameters() if not name.startswith("features_extractor")]
        rate: dict[str, Any] = {"lr": lr_schedule(1)}
        self.actor.optimizer = self.optimizer_class(learns, **rate, **self.optimizer_kwargs)


class _Detached(BaseFeaturesExtractor):
    """Evaluate another extractor without gradients."""

    def __init__(self, extractor: BaseFeaturesExtractor) -> None:
        super().__init__(extractor._observation_space, extractor.features_dim)
        self.extractor = extractor

    def forward(self, observations: Any) -> Any:
        with torch.no_grad():
            return self.extractor(observations)
