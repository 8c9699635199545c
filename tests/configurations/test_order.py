"""Numbering from frame to frame, for all three configurations: tracked, by the image, and across a gap."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from typing import NamedTuple

import numpy as np
import pytest

from shape_obs import Centerline, Configuration, Contour, ShapeDetector, Surface
from shape_obs.bench.scenes import moving_blob, moving_rope
from shape_obs.geometry.curve import FittedCurve
from tests.scenes.sheets import true_lattice, turning_sheet


class Frame(NamedTuple):
    """A mask, and the positions of the material of point 0 and of a point about a quarter further."""

    mask: np.ndarray
    marks: np.ndarray


def ropes() -> Iterator[Frame]:
    for rope in moving_rope(np.random.default_rng(9), 20, 120):
        yield Frame(rope.mask, rope.curve[[0, -1]])


def blobs() -> Iterator[Frame]:
    for blob in moving_blob(np.random.default_rng(2), turn=0.05, frames=130):
        yield Frame(blob.mask, blob.outline[[0]])


def sheets() -> Iterator[Frame]:
    for sheet in turning_sheet(np.random.default_rng(4), 1.5, step=3.0):
        lattice = true_lattice(sheet.points, 4, 8, "tips")
        yield Frame(sheet.mask, lattice[[0, 0, -1, -1], [0, -1, -1, 0]])


CASES = {
    "centerline": (ropes, Centerline(n=20, ends="tips"), [0, -1]),
    "contour": (blobs, Contour(n=32), [0]),
    "surface": (sheets, Surface(rows=4, cols=8, ends="tips"), [0, 7, 31, 24]),
}


@pytest.fixture(params=CASES)
def case(request):
    return CASES[request.param]


def anchored(spec: Configuration, frame: Frame, **options) -> ShapeDetector:
    return ShapeDetector([spec], anchor=tuple(frame.marks[0]), **options)


def test_a_shape_that_is_gone_for_a_while_comes_back_with_its_numbering(case):
    frames, spec, marked = case
    detector = None
    for index, frame in enumerate(islice(frames(), 60)):
        detector = detector or anchored(spec, frame, max_age=0.5)
        gone = index % 20 >= 14  # six frames, 0.2 s
        shape = detector.detect_mask(np.zeros_like(frame.mask) if gone else frame.mask).shapes[0]
        assert shape.ok
        assert bool(shape.reason) is gone
        if not gone:
            off = np.linalg.norm(shape.pixels[marked] - frame.marks, axis=1)
            assert off.max() < 8, index


def test_after_max_age_the_papers_rule_numbers_again(case):
    frames, spec, _ = case
    first, *_, last = islice(frames(), 60)
    detector = ShapeDetector([spec], max_age=0.5)
    detector.detect_mask(first.mask, stamp=0.0)
    detector.detect_mask(np.zeros_like(first.mask), stamp=1.0)
    again = detector.detect_mask(last.mask, stamp=600.0).shapes[0]
    fresh = ShapeDetector([spec]).detect_mask(last.mask).shapes[0]
    np.testing.assert_allclose(again.pixels, fresh.pixels, atol=0.5)
    assert (again.track_id, fresh.track_id) == (2, 1)


def test_order_by_the_image_numbers_every_frame_by_the_papers_rule(case):
    frames, spec, _ = case
    detector = ShapeDetector([spec], order="image")
    jumps = 0
    before = None
    for index, frame in enumerate(frames()):
        shape = detector.detect_mask(frame.mask).shapes[0]
        if index % 6 == 0:
            fresh = ShapeDetector([spec]).detect_mask(frame.mask).shapes[0]
            off = np.linalg.norm(shape.pixels - fresh.pixels, axis=1).max()
            # An outline that runs along the rule's diagonal has many points of the least u + v: noise chooses one.
            tied = spec.kind == "contour" and abs((shape.pixels[0] - fresh.pixels[0]).sum()) < 0.5
            assert off < (16 if tied else 8), index
        jumps += before is not None and np.linalg.norm(shape.pixels[0] - before) > 60
        before = shape.pixels[0]
    assert jumps >= 1  # point 0 leaves its material somewhere on the way round


def test_tracked_order_never_jumps(case):
    frames, spec, marked = case
    detector = None
    for frame in frames():
        detector = detector or anchored(spec, frame)
        shape = detector.detect_mask(frame.mask).shapes[0]
        assert np.linalg.norm(shape.pixels[marked] - frame.marks, axis=1).max() < 8


@pytest.mark.parametrize("target", [None, (170.0, 100.0)])
def test_a_contour_is_numbered_clockwise_whichever_way_it_was_traced(target):
    turn = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    points = np.stack([120 + 50 * np.cos(turn), 100 + 40 * np.sin(turn)], axis=1)  # clockwise: v runs down
    at, spec = None if target is None else np.array(target), Contour(n=8)
    forms = [FittedCurve.through(way, np.zeros(64, bool), closed=True) for way in (points, points[::-1])]
    one, other = (
        spec.resample(ordered, ordered).places
        for form in forms
        for ordered in [spec.apply_index_order(form, form.points, at)]
    )
    np.testing.assert_allclose(one, other, atol=0.5)
    (u, v), (du, dv) = (one[:-1] - (120, 100)).T, np.diff(one, axis=0).T
    assert np.all(u * dv - v * du > 0)
