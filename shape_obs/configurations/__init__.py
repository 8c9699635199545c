"""Configurations: what kind of shape is looked for, and how its points are ordered.

``centerline``, ``contour`` and ``surface`` each hold one; a detector loads those that it is asked for.
"""

from shape_obs.configurations.base import Anchor, Configuration, Ends, Lift, Order, Points, Spacing

__all__ = ["Anchor", "Configuration", "Ends", "Lift", "Order", "Points", "Spacing"]
