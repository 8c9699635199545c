"""The inner loops on NumPy: the readable reference."""

from __future__ import annotations

from typing import Final

from shape_obs.compiled.numpy_colour import reads_tables, seek, table_mask
from shape_obs.compiled.numpy_curve import arc_length, catmull_rom, equidistant, interpolate, spread, unshrink
from shape_obs.compiled.numpy_depth import median_depth
from shape_obs.compiled.numpy_fold import fold, unexplained
from shape_obs.compiled.numpy_map import best_matching_units, settle
from shape_obs.compiled.numpy_mask import carried, cells, survey
from shape_obs.compiled.numpy_outline import blend, border, followed, lag, miss, pairs, traced
from shape_obs.compiled.numpy_ring import ring
from shape_obs.compiled.numpy_sheet import (
    assessed,
    corners_near,
    gauges,
    laid,
    outer_corners,
    rim,
    sampled,
    strayed,
    tracked,
)
from shape_obs.compiled.numpy_strand import ribbon

compiled: Final = False

__all__ = [
    "arc_length",
    "assessed",
    "best_matching_units",
    "blend",
    "border",
    "carried",
    "catmull_rom",
    "cells",
    "compiled",
    "corners_near",
    "equidistant",
    "fold",
    "followed",
    "gauges",
    "interpolate",
    "lag",
    "laid",
    "median_depth",
    "miss",
    "outer_corners",
    "pairs",
    "reads_tables",
    "ribbon",
    "rim",
    "ring",
    "sampled",
    "seek",
    "settle",
    "spread",
    "strayed",
    "survey",
    "table_mask",
    "traced",
    "tracked",
    "unexplained",
    "unshrink",
]
