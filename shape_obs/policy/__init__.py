"""Policies: a trained network as ``policy.onnx`` and a contract, which run without the learner."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from shape_obs.policy.contract import Contract, PolicyError
from shape_obs.policy.policy import Policy, deploy_command, load_policy

if TYPE_CHECKING:
    from shape_obs.policy.export import save_policy as save_policy
    from shape_obs.policy.export import save_policy_onnx as save_policy_onnx

__all__ = ["Contract", "Policy", "PolicyError", "deploy_command", "load_policy", "save_policy", "save_policy_onnx"]


def __getattr__(name: str) -> Any:
    if name in ("save_policy", "save_policy_onnx"):
        from shape_obs.policy import export

        return getattr(export, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
