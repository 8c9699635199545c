"""Several objects of one kind in one mask: which part is whose, and each of them followed by a tracker of its own."""

from shape_obs.slots.slots import SLOT_FUNCTIONS, Slots

__all__ = ["SLOT_FUNCTIONS", "Slots"]
