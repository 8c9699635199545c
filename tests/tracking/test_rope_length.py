"""The length of a rope: what a frame may change of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shape_obs.geometry.curve import FittedCurve, Length
from shape_obs.tracking.occluders import FREE, HIDDEN, UNKNOWN
from shape_obs.tracking.rope_length import learnt, shortened

KNOWN = Length(pixels=300.0, metres=0.6, frames=20.0)


def seen(pixels: float, metres: float | None = None) -> FittedCurve:
    points = np.stack([np.linspace(100, 100 + pixels, 64), np.full(64, 240.0)], axis=1)
    form = FittedCurve.through(points, np.zeros(64, bool))
    return form if metres is None else replace(form, metres=np.linspace(0, metres, 64))


def test_a_rope_of_which_less_is_seen_has_neither_shrunk_nor_varied():
    known = KNOWN
    for _ in range(10):
        known = learnt(known, seen(270.0), (UNKNOWN, UNKNOWN))
    assert known.pixels > 285
    assert known.spread < 0.02


def test_a_slow_shadow_over_an_end_is_no_noise_in_metres():
    known = KNOWN._replace(spread_metres=0.002)
    for hidden in np.linspace(0, 0.03, 12):
        known = learnt(known, seen(300 * (1 - hidden), 0.6 * (1 - hidden)), (FREE, FREE))
    assert known.metres > 0.995 * KNOWN.metres
    assert known.spread_metres < 0.005


def test_a_rope_that_comes_back_to_its_length_is_seen_at_an_angle():
    known = KNOWN
    for pixels in 10 * (300.0, 318.0):
        known = learnt(known, seen(pixels), (FREE, FREE))
    assert known.spread > 0.02


def test_nothing_is_learnt_while_an_end_is_hidden():
    assert learnt(KNOWN, seen(320.0), (HIDDEN, FREE)) == KNOWN


def test_a_bridged_gap_makes_no_rope_longer_whose_end_was_never_seen():
    known = Length(pixels=300.0)
    bridged = replace(seen(320.0), interpolated=np.arange(64) // 16 == 1)
    assert learnt(known, bridged, (HIDDEN, FREE)) == known
    assert learnt(known, seen(320.0), (HIDDEN, FREE)).pixels == pytest.approx(320.0)


@pytest.mark.parametrize(("free", "frames", "changed"), [(True, 40, True), (True, 20, False), (False, 40, False)])
def test_a_rope_with_free_tips_has_changed_after_a_second(free, frames, changed):
    known = KNOWN
    for _ in range(frames):
        known = shortened(known, seen(200.0), free)
        if known.pixels < 210:
            break
    assert (known.pixels < 210) == changed
