"""Configurations: what kind of shape is looked for, and how its points are ordered."""

from shape_obs.configurations.base import Anchor, Configuration, Ends, Lift, Order, Points, Spacing
from shape_obs.configurations.centerline import Centerline
from shape_obs.configurations.contour import Contour
from shape_obs.configurations.surface import Surface

__all__ = ["Anchor", "Centerline", "Configuration", "Contour", "Ends", "Lift", "Order", "Points", "Spacing", "Surface"]
