"""Compile inner loops with Numba: the decorator, the cache on disk and the warm-up."""

from typing import Any

from shape_obs.compiled.decorator import compiled

__all__ = ["compile_now", "compiled"]


def compile_now(functions: Any) -> None: ...
