"""Run tests of random input at their full size: ``SHAPE_OBS_SWEEP=1 uv run pytest -n 0 --timeout 0 FILES``."""

from __future__ import annotations

import os


def sweep(few: int, full: int) -> int:
    """Return the small count of a test, or that share of the full count which ``SHAPE_OBS_SWEEP`` asks for."""
    share = float(os.environ.get("SHAPE_OBS_SWEEP", "0"))
    return max(round(share * full), few) if share else few
