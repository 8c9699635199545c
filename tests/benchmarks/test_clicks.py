"""Drawn photos: their truth is right by the measure that clicks are judged with, and wrong masks are not."""

from __future__ import annotations

import numpy as np
import pytest

from tests.benchmarks.clicks import first_click, is_right, next_click, overlap
from tests.benchmarks.scenes.object_photos import KINDS, THIN, ObjectPhoto, object_photo, object_sequence


@pytest.fixture(scope="module", params=KINDS)
def photo(request) -> ObjectPhoto:
    return object_photo(np.random.default_rng(4), request.param, "wood")


def test_the_true_mask_is_right_with_and_without_what_does_not_count(photo):
    assert is_right(photo.mask, photo)
    assert is_right(photo.mask | photo.ignored, photo)
    assert overlap(photo.mask | photo.ignored, photo) == 1
    assert next_click(photo.mask, photo) is None


def test_a_third_of_an_object_is_not_right_and_the_next_click_is_in_the_rest(photo):
    part = photo.mask.copy()
    rows, columns = np.nonzero(part)
    along = columns if np.ptp(columns) > np.ptp(rows) else rows
    keep = along < np.quantile(along, 1 / 3)
    part[rows[~keep], columns[~keep]] = False
    assert not is_right(part, photo)
    more = next_click(part, photo)
    assert more is not None
    (u, v), on = more
    assert on
    assert photo.mask[int(v), int(u)]
    assert not part[int(v), int(u)]


def test_first_clicks_are_on_the_object(photo):
    for seed in range(20):
        u, v = first_click(np.random.default_rng(seed), photo)
        assert photo.mask[int(v), int(u)]


def test_only_ropes_and_wires_have_an_axis(photo):
    assert (len(photo.centreline) > 100) == (photo.kind in THIN)


def test_the_object_of_a_sequence_moves_and_its_light_changes():
    frames = list(object_sequence(np.random.default_rng(2), "sheet", "plain", frames=30))
    assert min(overlap(frame.mask, frames[0]) for frame in frames) < 0.98
    bright = [float(frame.rgb[frame.mask].mean()) for frame in frames]
    assert max(bright) > 1.08 * min(bright)
    assert all(is_right(frame.mask, frame) for frame in frames)
