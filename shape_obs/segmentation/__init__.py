"""Pixel rules: which pixels belong to the object."""

from shape_obs.segmentation.base import Segmentation
from shape_obs.segmentation.colour import ColourRule
from shape_obs.segmentation.depth import DepthRange
from shape_obs.segmentation.gray import GrayRange
from shape_obs.segmentation.hsv import HSVRange

__all__ = ["ColourRule", "DepthRange", "GrayRange", "HSVRange", "Segmentation"]
