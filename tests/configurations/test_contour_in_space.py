"""A contour with equal gaps in space: spread over the curve that its own fit has measured there."""

from __future__ import annotations

import numpy as np

from shape_obs.configurations.contour import Contour
from shape_obs.geometry.curve import FittedCurve
from tests.benchmarks.outlines import seen_outline
from tests.benchmarks.scenes.flat_objects import View, in_space, noisy_depth, ring
from tests.benchmarks.scores import tally_visible


def curve(points: np.ndarray, space: np.ndarray | None = None) -> FittedCurve:
    form = FittedCurve.through(np.ascontiguousarray(points), np.zeros(len(points), bool), True)
    return form if space is None else FittedCurve(form.points, form.interpolated, form.arc, True, space=space)


def test_points_have_equal_gaps_where_the_form_was_measured():
    around = 2 * np.pi * np.arange(400) / 400
    flat = np.stack([300 + 100 * np.cos(around), 200 + 40 * np.sin(around)], axis=1)
    tilted = np.stack([np.cos(around), np.sin(around), np.zeros(400)], axis=1) / 4
    elsewhere = tilted * (1, 0.2, 1)
    spec = Contour(n=16, spacing="m")
    places = spec.resample(curve(flat, tilted), curve(elsewhere)).places
    back = (places - (300, 200)) / (100, 40)
    gaps = np.linalg.norm(np.roll(back, -1, axis=0) - back, axis=1)
    assert np.ptp(gaps) / gaps.mean() < 0.01
    assert np.allclose(spec.resample(curve(flat), curve(elsewhere)).places[0], places[0])


def test_a_steep_outline_in_a_small_image_keeps_its_index():
    view = View(height=120)
    rng = np.random.default_rng((500, 7))
    scenes = noisy_depth(in_space(rng, ring(rng, True), view, "tilted", 8.0, 120), view, 500)
    found = tally_visible(list(seen_outline(scenes, view, True)))
    assert found.slips < 1, found
    assert found.refused < 1
