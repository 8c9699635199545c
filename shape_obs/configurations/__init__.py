"""Configurations: what kind of shape is looked for, and how its points are ordered."""

from shape_obs.configurations.base import Anchor, Configuration, Order, Spacing
from shape_obs.configurations.centerline import Centerline, Ends

__all__ = ["Anchor", "Centerline", "Configuration", "Ends", "Order", "Spacing"]
