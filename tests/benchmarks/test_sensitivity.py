"""The benchmark that halves and doubles constants: what it changes and restores, and shapes that are never found."""

from __future__ import annotations

import numpy as np
import pytest

from shape_obs import Centerline, Contour
from tests.benchmarks.claim import Effort
from tests.benchmarks.sensitivity import changed, measure, model_of, scenes, values
from tests.scenes.beams import swinging_beam, tracked_beam


def test_every_value_of_every_model_is_halved_and_doubled():
    whole = scenes(Effort())
    assert len({(each["kind"], each["constant"], each["place"], each["factor"]) for each in whole}) == len(whole)
    assert {("hiding_rate", 0), ("hiding_rate", 2), ("max_drift", None)} <= set(values(Centerline))
    assert len(scenes(Effort(share=0.1))) == pytest.approx(len(whole) / 10, abs=1)


def test_one_value_of_several_is_changed():
    model = changed(Centerline.model, "hiding_rate", 1, 2.0)
    assert model.hiding_rate == (1.5, 6.0, 1.5)  # pyright: ignore[reportAttributeAccessIssue]


def test_outlines_with_fewer_nodes_change_and_the_model_is_restored():
    before = Contour.model
    row = measure({"kind": "outline", "constant": "node_spacing", "place": None, "factor": 2.0, "seed": 0})
    assert row.changed == row.streams > 0
    assert Contour.model is before


def test_a_beam_that_is_never_found_is_refused_in_every_frame():
    with model_of(Centerline, changed(Centerline.model, "max_scatter", None, 0.5)):  # less than that of a ribbon
        found = tracked_beam(swinging_beam(np.random.default_rng(0), 30, 4, 20))
    assert found["refused"] == found["frames"] == found["longest"]
    assert found["turned"] == found["strayed"] == 0
