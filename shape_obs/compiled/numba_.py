"""The inner loops on Numba."""

from __future__ import annotations

from typing import Final

from shape_obs.compiled.numba_colour import reads_tables, seek, table_mask
from shape_obs.compiled.numba_curve import arc_length, catmull_rom, equidistant, interpolate, spread, unshrink
from shape_obs.compiled.numba_depth import median_depth
from shape_obs.compiled.numba_fold import fold, unexplained
from shape_obs.compiled.numba_lattice import assessed, gauges, sampled, strayed
from shape_obs.compiled.numba_map import best_matching_units, settle
from shape_obs.compiled.numba_mask import carried, cells, survey
from shape_obs.compiled.numba_outline import border, miss, pairs
from shape_obs.compiled.numba_phase import blend, followed, lag
from shape_obs.compiled.numba_ring import ring
from shape_obs.compiled.numba_sheet import corners_near, laid, outer_corners, rim, tracked
from shape_obs.compiled.numba_strand import ribbon
from shape_obs.compiled.numba_trace import traced

compiled: Final = True

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
