"""Bundles: a trained policy with all that it takes to run it elsewhere."""

from __future__ import annotations

from shape_obs.deploy.policy_bundle.documents import BundleError
from shape_obs.deploy.policy_bundle.storage import load_bundle
from shape_obs.deploy.policy_bundle.policy import Bundle
from shape_obs.deploy.policy_bundle.storage import save_bundle

__all__ = ["Bundle", "BundleError", "load_bundle", "save_bundle"]
