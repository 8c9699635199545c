"""Policy bundles: a trained policy in one file, with everything needed to run it elsewhere."""

from __future__ import annotations

from shape_obs.deploy.policy_bundle.documents import BundleError
from shape_obs.deploy.policy_bundle.next_command import deploy_command
from shape_obs.deploy.policy_bundle.policy import Bundle, PolicyController
from shape_obs.deploy.policy_bundle.storage import load_bundle, save_bundle

__all__ = ["Bundle", "BundleError", "PolicyController", "deploy_command", "load_bundle", "save_bundle"]
