"""Which backends the detector has here, and what they are called in tables."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Final, Literal

Backend = Literal["numpy", "numba"]
LABELS: Final[dict[Backend, str]] = {"numpy": "NumPy", "numba": "Numba"}


def backends() -> tuple[Backend, ...]:
    """What the detector can run on here."""
    return tuple(name for name in LABELS if find_spec(name))


def ours(backend: Backend, start: str) -> str:
    """What the detector is called in the tables."""
    return f"shape_obs, {LABELS[backend]}, {start}"
