"""The inner loops on Numba."""

from __future__ import annotations

from shape_obs.kernels.numpy_ import best_matching_units, som_epoch

__all__ = ["best_matching_units", "som_epoch"]
