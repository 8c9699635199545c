"""Bundles: a trained policy with all that it takes to run it elsewhere."""

from __future__ import annotations

from shape_obs.deploy.policy_bundle.errors import BundleError
from shape_obs.deploy.policy_bundle.loading import load_bundle
from shape_obs.deploy.policy_bundle.policy import Bundle
from shape_obs.deploy.policy_bundle.saving import save_bundle

__all__ = ["Bundle", "BundleError", "load_bundle", "save_bundle"]
