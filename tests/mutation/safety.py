"""Faults in what stands between a policy and a robot."""

from __future__ import annotations

from .mutant import Mutant

_EYE = "envs/shape_obs_envs/cell/eye.py"
_EYE_TESTS = ("tests/test_eye.py",)

# The gate of a deployment, its loop and watchdog, and the guard: to be listed here.
SAFETY: tuple[Mutant, ...] = (
    Mutant("safety: frames of any age are taken", _EYE, "max_age=max(0.0, time.monotonic() - moment)",
           "max_age=1e9", _EYE_TESTS),
    Mutant("safety: queued frames are taken", _EYE, "frame.received >= moment", "frame.received >= 0", _EYE_TESTS),
    Mutant("safety: a moment to come is not waited for", _EYE, "max_age=max(0.0, time.monotonic() - moment)",
           "max_age=abs(time.monotonic() - moment)", _EYE_TESTS),
    Mutant("safety: recordings are waited for", _EYE, " or not self.source.live:", ":", _EYE_TESTS),
)  # fmt: skip
