"""Policy bundles: a trained policy in one file, with everything needed to run it elsewhere."""

from __future__ import annotations

from shape_obs.deploy.policy_bundle.documents import BundleError
from shape_obs.deploy.policy_bundle.policy import Bundle, PolicyController
from shape_obs.deploy.policy_bundle.storage import load_bundle, save_bundle

__all__ = ["Bundle", "BundleError", "PolicyController", "load_bundle", "save_bundle"]
