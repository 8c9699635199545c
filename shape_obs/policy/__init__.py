"""Policies: a trained network as ``policy.onnx`` and a contract, which run without the learner."""

from __future__ import annotations

from shape_obs.policy.contract import Contract as Contract
from shape_obs.policy.contract import PolicyError as PolicyError
from shape_obs.policy.export import save_policy as save_policy
from shape_obs.policy.export import save_policy_onnx as save_policy_onnx
from shape_obs.policy.policy import Policy as Policy
from shape_obs.policy.policy import deploy_command as deploy_command
from shape_obs.policy.policy import load_policy as load_policy
