"""Regions of interest: which part of the image is looked at. One kind a file."""

from __future__ import annotations

from shape_obs.roi.base import ROI as ROI
from shape_obs.roi.base import Place as Place
from shape_obs.roi.base import Window as Window
from shape_obs.roi.markers import Markers as Markers
from shape_obs.roi.polygon import Polygon as Polygon
from shape_obs.roi.rectangle import Rectangle as Rectangle
from shape_obs.roi.whole import Whole as Whole
