"""Contours of drawn blobs and real garments: what `shape-obs bench claims` measures on more of them and more seeds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from shape_obs import Contour, ShapeDetector
from shape_obs.bench.scenes import draw_blob
from tests.benchmarks.contour_claims import MOTIONS, drawn_blobs, flickering_blobs, outlines, turning_blobs
from tests.benchmarks.scenes.blobs import garments

GARMENTS = Path(__file__).parents[3] / "shared/data/real/garment_silhouettes.json"
needs_garments = pytest.mark.skipif(not GARMENTS.exists(), reason="the garment silhouettes are not here")


@pytest.fixture(scope="module")
def drawn():
    return list(outlines(drawn_blobs(per_kind=6, seed=5)))


@pytest.fixture(scope="module")
def clothes():
    return list(outlines(garments(GARMENTS), counts=(16, 32, 64)))


@pytest.fixture(scope="module", params=[pytest.param("clothes", marks=needs_garments), "drawn"])
def found(request):
    return request.getfixturevalue(request.param)


class TestClaims:
    """What `shape-obs bench claims` measures on more blobs and seeds."""

    def test_every_outline_is_found_in_order(self, found):
        assert [result for result in found if not result.ok] == []
        assert [result for result in found if not (result.ordered and result.clockwise)] == []

    def test_points_lie_on_the_true_outline(self, found):
        assert max(result.distance for result in found) <= 0.3
        assert np.mean([result.distance for result in found]) <= 0.15

    def test_gaps_are_equal_where_the_outline_does_not_bend_within_one(self, found):
        assert max(result.gap_cv for result in found if not result.coarse) <= 0.01

    def test_few_outlines_bend_so_far_within_a_gap(self, found):
        assert max((result.gap_cv for result in found if result.coarse), default=0.0) <= 0.2
        assert np.mean([result.coarse for result in found]) <= 0.15

    @needs_garments
    def test_gaps_are_equal_on_every_garment(self, clothes):
        assert max(result.gap_cv for result in clothes) <= 0.01

    @needs_garments
    def test_corners_of_towels_are_near_a_point(self):
        """Images have the size of the photos; 64 points on the annotated polygon itself miss the corners by 0.45 %."""
        towels = (blob for blob in garments(GARMENTS, size=(1242, 2208)) if blob.kind == "towels")
        missed = [corner for result in outlines(towels, counts=(64,)) for corner in result.corners]
        assert len(missed) == 153
        assert np.median(missed) <= 0.005

    def test_a_turning_outline_keeps_its_index(self):
        some = {name: MOTIONS[name] for name in ("nearly round", "40 px a frame", "hole")}
        for result in turning_blobs(some):
            assert (result.disordered, result.slips, result.not_ok) == (0, 0, 0), result
            assert result.worst_slip <= 0.1
            assert result.mean_distance <= 0.15

    def test_nor_does_a_small_round_one_move_along_itself(self):
        some = {name: MOTIONS[name] for name in ("circle, 160 x 120", "nearly round, 160 x 120")}
        for result in turning_blobs(some, seeds=(0, 1)):
            assert (result.disordered, result.slips, result.not_ok) == (0, 0, 0), result

    @needs_garments
    @pytest.mark.parametrize("which", [0, 45, 100], ids=["towel", "tshirt", "shorts"])
    def test_a_turning_garment_keeps_its_index(self, which):
        """A towel looks the same after half a turn."""
        blob = list(garments(GARMENTS))[which]
        outline = 0.8 * (blob.outline - blob.outline.mean(axis=0))
        detector, first = ShapeDetector([Contour()]), None
        for angle in 0.08 * np.arange(60):
            turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
            shape = detector.detect_mask(draw_blob(outline @ turn + (319.5, 239.5)).mask).shapes[0]
            points = (shape.points2d - (319.5, 239.5)) @ turn.T
            first = points if first is None else first
            assert np.linalg.norm(points - first, axis=1).mean() < 1.5

    def test_a_deforming_outline_keeps_its_index(self):
        (result,) = turning_blobs({"deforming": MOTIONS["deforming"]})
        assert (result.disordered, result.slips, result.not_ok) == (0, 0, 0)

    def test_an_outline_that_flickers_stands_still(self):
        """Where an outline bends within a gap, equal chords amplify the noise; equal arcs would keep to 0.3 px."""
        results = list(flickering_blobs(drawn_blobs(2, seed=5), flipped=(0.05,), frames=40))
        assert sum(result.not_ok for result in results) == 0
        assert max(result.rms for result in results if result.kind == "smooth") <= 0.3
        assert np.median([result.rms for result in results]) <= 0.3
        assert max(result.drift for result in results) <= 0.6
