"""PolicyController: a trained policy as a controller of the deployment loop."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy.typing as npt

from shape_obs.deploy.policy_bundle.spaces import zeros
from shape_obs.robot import ActionSpec

if TYPE_CHECKING:
    from shape_obs.deploy.policy_bundle.policy import Bundle


class PolicyController:
    """Acts as the policy does, without exploring.

    Args:
        bundle: The policy.
        same_rate: Whether it refuses a loop at another rate than it was trained at.

    Attributes:
        same_rate: As given.
        action_spec: What its actions mean; ``shape_obs.deploy.deploy`` holds it against the robot's.
    """

    def __init__(self, bundle: Bundle, *, same_rate: bool = True) -> None:
        self._bundle, self.same_rate = bundle, same_rate
        self.action_spec: ActionSpec | None = bundle.action_spec

    def attach(self, env: Any) -> None:
        """Hold the environment against that of the training.

        Raises:
            BundleError: It is another one; the message names each difference.
        """
        self._bundle.check_env(env, same_rate=self.same_rate)
        self._bundle.act(zeros(env.observation_space))  # the first time takes longer, and the loop has a deadline

    def bind(self, spec: ActionSpec) -> None:
        """Nothing to size: actions are those of the training."""

    def reset(self) -> None:
        """Nothing to forget: the policy has no memory."""

    def act(self, observation: Any) -> npt.NDArray[Any]:
        """The action (A,) in -1 ... 1."""
        return self._bundle.act(observation)
