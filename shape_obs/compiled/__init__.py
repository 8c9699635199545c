"""Compile inner loops with Numba: one signature for each function, cached on disk, announced on stderr.

Decorate a function that Python calls with its signatures, and a function that only compiled functions call with the
bare decorator::

    @compiled("(f8[:,::1],)")
    def arc_length(curve): ...

    @compiled
    def _square(x): ...

Nothing is compiled at import. ``compile_now`` loads or compiles several functions at once, before the first frame; a
function that was left out is loaded or compiled at its first call. A call with arrays of another type or layout raises
``TypeError``.
"""

from shape_obs.compiled.decorator import compile_now, compiled

__all__ = ["compile_now", "compiled"]
