"""The time from frame to frame, also where stamps do not show it, and stamps that are not in seconds."""

from __future__ import annotations

import numbers
import warnings
from statistics import median
from typing import Final

import numpy as np

_LEAST_STEP: Final = 1e-6  # seconds; a clock that ticks more slowly stands still
LONGEST_PAUSE: Final = 86_400.0  # seconds, a day: no stream pauses for so long, but clocks are set by years
_SAMPLE: Final = 5  # steps whose median shows the unit
#: The least step in seconds, as stamps are read, from which it is likelier that they are in another unit: what is
#: filmed every 4 s cannot be tracked, and 4 ms are 250 Hz. A step of 1 is one frame a second.
_UNITS: Final = (
    (1e6, "nanoseconds", 1e9, "1e9"),
    (1e3, "microseconds", 1e6, "1e6"),
    (4.0, "milliseconds", 1e3, "1000"),
)  # seconds, their unit, and what a second is in it, as a number and in words
_TICKS: Final = (1.6e5, "ticks of 100 ns", 1e7, "1e7")  # the unit of Windows and .NET, at up to 62 frames a second
_MOST_TICKS: Final = 2e6  # five frames a second
_UNIX: Final = (1e9, 4e9)  # seconds since 1970, from 2001 to 2096: stamps of this size are seconds
_LONGEST_LAPSE: Final = 1e6  # seconds: recordings that last for weeks may have one each week
_FASTEST: Final = 1e-4  # seconds, ten times as fast as the fastest cameras: seconds that were divided by 1000
_COARSEST: Final = 1e-3  # seconds; stamps with a coarser step do not show the time between frames


class Clock:
    """Measure the time from frame to frame, also if the stamps do not.

    Where a stamp stands still, runs back or jumps by more than a day (a camera that froze, or whose clock was set),
    ``dt`` passes: no shape stays young, and none becomes old, because its camera's clock failed.

    Args:
        dt: Seconds between frames without stamps.

    Attributes:
        stamp: Of the last frame, as given, in seconds; without stamps frames are ``dt`` apart.
        now: Seconds since the first frame; grows with each frame.
        warning: What is wrong with the last stamp; empty if nothing is.

    Warns:
        UserWarning: Once, if the first stamps are not in seconds as far as can be seen; see also ``explain_loss``.
    """

    def __init__(self, dt: float = 1 / 30) -> None:
        self._dt = dt
        self._warned = False
        self._steps: list[float] = []  # the first ones, also from earlier tracks
        self.reset()

    def reset(self) -> None:
        """Start again with the next frame."""
        self._started = False
        self._still = 0  # frames since the stamp last went on
        self.stamp, self.now, self.warning = 0.0, 0.0, ""

    def tick(self, stamp: float | None) -> None:
        """Go on to the next frame, with its stamp in seconds if it has one."""
        step, self.warning = self._dt, ""
        if not self._started:
            self._started, step = True, 0.0
            self.stamp = 0.0 if stamp is None else float(stamp)
        elif stamp is None:
            self.stamp += step
        else:
            shown, self.stamp = float(stamp) - self.stamp, float(stamp)
            if _LEAST_STEP <= shown <= LONGEST_PAUSE:
                step = shown
            else:
                what = "stands still" if abs(shown) < _LEAST_STEP else "jumps" if shown > 0 else "runs back"
                self.warning = f"the stamp {what}: dt is taken as the time since the last frame"
            if len(self._steps) < _SAMPLE and not self._warned:
                self._look_at(stamp, shown)
        self.now += step

    def explain_loss(self, max_age: float) -> None:
        """Warn once if a track ends with a single frame because stamps are a second or more from each other."""
        usual = median(self._steps) if len(self._steps) == _SAMPLE else 0.0
        if not self._warned and usual >= 1 and 0 < max_age < usual:
            text = f"{usual:.3g} s from frame to frame, so a track ends with one frame without the shape: max_age is"
            self._warn(f"{text} {max_age:g} s. Raise it, or give seconds if the stamps are something else", 7)

    def _look_at(self, stamp: float, step: float) -> None:
        """Warn if the first steps are those of another unit."""
        if step < 0:
            return
        if isinstance(stamp, np.floating) and stamp.dtype.itemsize < 8 and np.spacing(stamp) > _COARSEST:
            return self._warn(f"{stamp.dtype} at {stamp:g} resolves {np.spacing(stamp):g} s: give float64")
        if step < _LEAST_STEP:
            self._still += 1
            return
        if self._still >= _SAMPLE and step.is_integer():
            return self._warn(
                f"they stood still for {self._still} frames and went on by {step:g}: give parts of seconds"
            )
        self._still = 0
        self._steps.append(step)
        if len(self._steps) < _SAMPLE:
            return
        usual = median(self._steps)
        if _UNIX[0] <= stamp <= _UNIX[1] and 1 <= usual < _LONGEST_LAPSE:
            return
        read = f"{usual:.3g} s from frame to frame as they are read"
        seconds = "; if they are seconds, leave them: they are read as such" if usual <= LONGEST_PAUSE else ""
        for least, unit, scale, text in (_TICKS, *_UNITS) if usual.is_integer() and usual <= _MOST_TICKS else _UNITS:
            if usual >= least:
                look = f"{read}, but they look like {unit}, {scale / usual:.3g} frames a second"
                return self._warn(f"{look}: give stamp / {text}{seconds}")
        if usual < _FASTEST:
            self._warn(f"{read}, but they look like seconds divided by 1000: give stamp * 1000")
        elif isinstance(stamp, numbers.Integral) and usual >= 1:
            give = "give stamp / fps, or no stamp and dt=1 / fps"
            self._warn(f"{read}, but they look like frame numbers: {give}{seconds}")

    def _warn(self, text: str, level: int = 6) -> None:
        self._warned = True
        warnings.warn(f"stamps: {text}. This warning is shown once.", stacklevel=level)
