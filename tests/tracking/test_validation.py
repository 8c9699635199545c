"""The quality check, one criterion at a time: each test fails if that criterion is removed."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from shape_obs import Centerline, Contour, ShapeDetector
from shape_obs.geometry.curve import FittedCurve
from shape_obs.geometry.lattice import FittedLattice, assess_lattice
from shape_obs.image.find_region import find_region
from shape_obs.image.region import Region
from shape_obs.image.roi import Window
from shape_obs.tracking.judge_chain import reason_of
from shape_obs.tracking.model import ChainModel, LatticeModel, RingModel
from shape_obs.tracking.scene import NO_MASK
from shape_obs.tracking.state import new_rope
from shape_obs.tracking.step import step_chain
from shape_obs.tracking.validation import FitQuality, judge_sheet, sample_spread, sheet_fault, validate_outline

SIZE = (120, 400)


def region(mask: np.ndarray) -> Region:
    return find_region(mask, Window(0, 0, mask.shape[1], mask.shape[0]), 1, 0.0)


def rope(thick: int = 10, last: int = 300) -> Region:
    """Return a straight ribbon from column 20 to ``last``, around row 60."""
    mask = np.zeros(SIZE, np.uint8)
    mask[60 - thick // 2 : 60 + thick // 2, 20:last] = 1
    return region(mask)


def straight(observed: Region, end: float, row: float = 59.5) -> FittedCurve:
    """Return a curve from column 20 to ``end``; interpolated where it lies off the mask."""
    points = np.stack([np.linspace(20, end, 281), np.full(281, row)], axis=1)
    return FittedCurve.through(points, ~observed.carries(points))


def judged_ribbon(curve: FittedCurve, observed: Region, expected_off: float) -> FitQuality:
    """Validate a curve by the samples of the mask; the spread within their cells is estimated."""
    samples = observed.gather(min(max(observed.width / 3, 1), 24))
    hidden = min(samples.scale, observed.width) ** 2 / 12
    spread = sample_spread(samples.points, samples.weight, curve.points) + hidden
    nothing, none, model = np.zeros(0), np.zeros((0, 2)), ChainModel()
    before = new_rope(model), none, none, nothing, nothing, none, 0.0, False, np.inf
    cloud = curve.points, curve.interpolated, spread, observed.width, 1.0
    state, *_ = step_chain(
        NO_MASK, cloud, observed.area, curve.points[::18].copy(), 0.0, expected_off, False, before, model.record
    )
    return FitQuality(reason_of(state, observed.noun), float(state["quality"][0]))


def judged_sheet(form: FittedLattice, kink: float) -> FitQuality:
    off, model = float(form.interpolated.mean()), LatticeModel().record
    fault, quality = judge_sheet(off, assess_lattice(form.lattice), kink, 0, 0.0, 0.06, model)
    return FitQuality(sheet_fault(fault, "mask"), quality)


class TestOffTheMask:
    """280 px of the curve lie on the rope."""

    def test_up_to_a_tenth_of_the_curve_may_lie_off(self):
        observed = rope()
        on, near = (
            judged_ribbon(straight(observed, 299), observed, 0.0),
            judged_ribbon(straight(observed, 324), observed, 0.0),
        )
        assert (on.reason, near.reason) == ("", "")
        assert on.quality > 0.9
        assert 0.3 < near.quality < 0.6  # 8 % off

    def test_more_is_refused_even_if_the_rest_is_good(self):
        """The spread alone would pass it: the rope is a ribbon about the curve."""
        observed = rope()
        verdict = judged_ribbon(straight(observed, 340), observed, 0.0)
        assert verdict == ("12% of the curve lies off the mask (at most 10%)", 0.0)


class TestSpread:
    """The root mean square distance of the mask from the curve, over the width of a ribbon of that area and length."""

    def test_a_curve_along_one_edge_is_refused_though_all_of_it_lies_on_the_mask(self):
        observed = rope(thick=16)
        curve = straight(observed, 299, row=52.0)
        assert not curve.interpolated.any()
        verdict = judged_ribbon(curve, observed, 0.0)
        assert verdict.reason.startswith("the mask spreads 0.5")
        assert verdict.reason.endswith("widths about the curve (a ribbon 0.29, at most 0.40): it is no single rope")
        assert verdict.quality == 0

    @pytest.mark.parametrize("thick", [24, 30])
    def test_quality_is_that_of_every_pixel(self, thick):
        """The rope tapers from 1.67 to 0.33 of its mean width; the distances of all its pixels count."""
        mask = np.zeros((120, 560), np.uint8)
        half = thick / 2 * np.linspace(5 / 3, 1 / 3, 520)
        mask[:, 20:540] = np.abs(np.arange(120)[:, None] - 60) < half
        away = np.abs(np.nonzero(mask)[0] - 60)
        ratio = np.sqrt(np.mean(away**2)) / (np.count_nonzero(mask) / 520)
        expected = (1 - (ratio - 12**-0.5) / (0.40 - 12**-0.5)) ** 0.5
        assert 0.5 < expected < 0.8
        shape = ShapeDetector(Centerline(n=9)).detect_mask(mask).shapes[0]
        assert shape.quality == pytest.approx(expected, abs=0.04)

    def test_the_detector_refuses_a_rope_with_a_thick_end(self):
        """The mask is a lollipop: every part of its curve lies on the mask, and it does not branch."""
        mask = np.zeros((240, 400), np.uint8)
        mask[116:124, 20:300] = 1
        cv2.circle(mask, (320, 120), 34, 1, -1)
        shape = ShapeDetector(Centerline(n=9)).detect_mask(mask).shapes[0]
        assert not shape.ok
        assert shape.reason.endswith("it is no single rope")


class TestOutline:
    def test_an_outline_may_miss_its_samples_by_three_quarters(self):
        observed = rope()
        assert validate_outline(observed, 0.1, RingModel()) == ("", 1.0)
        assert validate_outline(observed, 0.74, RingModel()).reason == ""
        assert validate_outline(observed, 0.45, RingModel()).quality == pytest.approx(0.5**0.5)
        assert (
            validate_outline(observed, 0.76, RingModel()).reason
            == "the outline misses the mask's by 0.76 samples (at most 0.75)"
        )

    def test_the_detector_reports_pieces(self):
        mask = np.zeros(SIZE, np.uint8)
        mask[20:100, 20:120] = mask[20:100, 200:290] = 1
        reason = ShapeDetector(Contour(n=9)).detect_mask(mask).shapes[0].reason
        assert reason == "the mask falls into 2 pieces, and the largest is 53% of it (at least 60%)"


class TestSheet:
    """A square sheet of 160 px and lattices over it, each wrong in one respect."""

    @pytest.fixture
    def observed(self):
        mask = np.zeros((240, 320), np.uint8)
        mask[40:201, 80:241] = 1
        return region(mask)

    @staticmethod
    def lattice(
        observed: Region, corners=((80, 40), (240, 40), (240, 200), (80, 200)), bow: float = 0.0
    ) -> FittedLattice:
        """Return a bilinear lattice, 17 x 17, whose upper side is bowed inwards by some pixels."""
        at = np.linspace(0, 1, 17)
        v, u = (side[..., None] for side in np.meshgrid(at, at, indexing="ij"))
        first, second, third, fourth = np.array(corners, float)
        points = (1 - v) * ((1 - u) * first + u * second) + v * ((1 - u) * fourth + u * third)
        points[..., 1] += bow * np.sin(np.pi * u[..., 0]) * (1 - v[..., 0])
        flat = points.reshape(-1, 2)
        return FittedLattice.over(flat, ~observed.carries(flat), 17)

    @pytest.mark.parametrize(
        ("corners", "bow", "kink", "reason"),
        [
            (((60, 40), (240, 40), (240, 200), (60, 200)), 0, 0, "of the lattice lies off the mask (at most 10%)"),
            (((80, 40), (110, 190), (110, 200), (80, 50)), 0, 0, "a corner of the lattice is 79 degrees off"),
            (((80, 40), (240, 40), (240, 200), (80, 200)), 0, 61, "the outline turns by 61 degrees between two"),
            (((80, 40), (240, 40), (240, 200), (80, 200)), 55, 0, "a side is 2"),
            (((90, 50), (230, 50), (165, 190), (155, 190)), 0, 0, "the areas of the lattice's cells vary by"),
        ],
    )
    def test_each_fault_is_refused_by_its_own_check(self, observed, corners, bow, kink, reason):
        verdict = judged_sheet(self.lattice(observed, corners, bow), kink)
        assert reason in verdict.reason
        assert verdict.quality == 0

    def test_a_lattice_that_folds_is_refused(self, observed):
        lattice = self.lattice(observed).lattice.copy()
        lattice[4:12, 4:12] = lattice[4:12, 11:3:-1]
        folded = FittedLattice.over(lattice.reshape(-1, 2), np.zeros(289, bool), 17)
        assert "the lattice folds at" in judged_sheet(folded, 0.0).reason

    def test_quality_falls_with_kinks(self, observed):
        assert judged_sheet(self.lattice(observed), 45.0).quality < 0.75
