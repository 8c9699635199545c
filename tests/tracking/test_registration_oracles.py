"""Numbering outlines in the plane agrees with numbering them in space, which NumPy's transforms do."""

from __future__ import annotations

import numpy as np
import pytest

from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.outline import material_outline
from shape_obs.geometry.rotation import fit
from shape_obs.tracking.registration import renumber_outline
from shape_obs.tracking.registration_in_space import index_shift_space


@pytest.mark.parametrize("angle", [0.0, 0.3, -1.0])
def test_the_plane_is_a_plane_in_space(angle):
    phase = np.linspace(0, 2 * np.pi, 700, endpoint=False)
    radius = 100 + 20 * np.cos(2 * phase + 0.4) + 9 * np.sin(3 * phase) + 4 * np.cos(5 * phase + 2)
    _, smooth = material_outline(300 + radius[:, None] * np.stack([np.cos(phase), np.sin(phase)], axis=1), False)
    curve = FittedCurve.through(smooth, np.zeros(len(smooth), bool), closed=True)
    reference = curve.starting_at(31.4).even(90)
    predicted = reference + (3, -2)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    points, arc, nodes, blended, _ = renumber_outline(curve.points @ turn, reference, predicted)
    again = FittedCurve.through(points, np.zeros(len(points), bool), closed=True)
    np.testing.assert_allclose(arc, again.arc)
    np.testing.assert_allclose(nodes, again.even(90), atol=1e-6)
    np.testing.assert_allclose(nodes, reference @ turn, atol=0.2)
    before, expected, there = (np.pad(values, ((0, 0), (0, 1))) for values in (reference, predicted, nodes))
    shift, _ = index_shift_space(before, expected, there, there, 1.0)
    assert (shift + 45) % 90 - 45 == pytest.approx(0, abs=0.02)
    laid = fit(reference, nodes).apply(reference)
    most = 0.003 * np.sqrt(((reference - reference.mean(axis=0)) ** 2).sum(axis=1).mean())
    np.testing.assert_allclose(blended, laid + np.clip(0.05 * (nodes - laid), -most, most), atol=1e-6)
