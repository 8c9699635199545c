"""What the quality check refuses, one check at a time: each test fails if that single check is removed."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from shape_obs.geometry.form import Curve, Patch

from shape_obs import Centerline, Contour, ShapeDetector
from shape_obs.compiled import choose
from shape_obs.image.region import Region, find_region
from shape_obs.image.roi import Window
from shape_obs.tracking.validation import judge_outline, judge_ribbon, judge_sheet

SIZE = (120, 400)


@pytest.fixture(params=["numpy", "numba"])
def kernels(request):
    return choose(request.param)


def region(mask: np.ndarray, kernels) -> Region:
    return find_region(mask, Window(0, 0, mask.shape[1], mask.shape[0]), 1, 0.0, kernels)


def rope(kernels, thick: int = 10, last: int = 300) -> Region:
    """A straight ribbon from column 20 to ``last``, around row 60."""
    mask = np.zeros(SIZE, np.uint8)
    mask[60 - thick // 2 : 60 + thick // 2, 20:last] = 1
    return region(mask, kernels)


def straight(body: Region, end: float, row: float = 59.5) -> Curve:
    """A curve from column 20 to ``end``; bridged where it lies off the body."""
    points = np.stack([np.linspace(20, end, 281), np.full(281, row)], axis=1)
    return Curve(points, ~body.carries(points), kernels=body.kernels)


class TestOffTheMask:
    """280 px of the curve lie on the rope."""

    def test_up_to_a_tenth_of_the_curve_may_lie_off(self, kernels):
        body = rope(kernels)
        on, near = judge_ribbon(straight(body, 299), body, 0.0), judge_ribbon(straight(body, 324), body, 0.0)
        assert (on.reason, near.reason) == ("", "")
        assert on.quality > 0.9
        assert 0.3 < near.quality < 0.6  # 8 % off

    def test_more_is_refused_whatever_the_rest_looks_like(self, kernels):
        """The spread alone would pass it: the rope is a ribbon about the curve."""
        body = rope(kernels)
        verdict = judge_ribbon(straight(body, 340), body, 0.0)
        assert verdict == ("12% of the curve lies off the mask (at most 10%)", 0.0)

    def test_what_is_known_to_be_bridged_is_allowed_and_no_more(self, kernels):
        body = rope(kernels)
        assert judge_ribbon(straight(body, 399), body, 0.25).reason == ""
        assert judge_ribbon(straight(body, 399), body, 0.28).quality > 0.9  # the width is that of what is seen
        assert (
            judge_ribbon(straight(body, 399), body, 0.10).reason == "16% of the curve lies off the mask (at most 10%)"
        )


class TestSpread:
    """The root mean square distance of the mask from the curve, over the width of a ribbon of that area and length."""

    def test_a_ribbon_spreads_by_its_width_over_the_root_of_twelve(self, kernels):
        body = rope(kernels)
        assert judge_ribbon(straight(body, 299), body, 0.0).quality == pytest.approx(1.0, abs=0.03)

    def test_a_curve_along_one_edge_is_refused_though_all_of_it_lies_on_the_mask(self, kernels):
        body = rope(kernels, thick=16)
        curve = straight(body, 299, row=52.0)
        assert not curve.bridged.any()
        verdict = judge_ribbon(curve, body, 0.0)
        assert verdict.reason.startswith("the mask spreads 0.5")
        assert verdict.reason.endswith("widths about the curve (a ribbon 0.29, at most 0.40): it is no single rope")
        assert verdict.quality == 0

    def test_a_second_rope_beside_the_curve_is_refused(self, kernels):
        mask = np.zeros(SIZE, np.uint8)
        mask[55:65, 20:300] = mask[85:95, 20:300] = 1
        body = region(mask, kernels)
        assert "it is no single rope" in judge_ribbon(straight(body, 299), body, 0.0).reason

    @pytest.mark.parametrize("aside", [2.0, 4.0, 5.0])
    def test_quality_falls_as_the_spread_grows(self, kernels, aside):
        """Samples are cells of 8 px here, and the spread within them counts: (24^2 / 12 + aside^2) ** 0.5 / 24."""
        body = rope(kernels, thick=24)
        spread = (24**2 / 12 + aside**2) ** 0.5 / 24
        expected = (1 - (spread - 12**-0.5) / (0.40 - 12**-0.5)) ** 0.5
        verdict = judge_ribbon(straight(body, 299, 59.5 - aside), body, 0.0)
        assert verdict.quality == pytest.approx(expected, abs=0.04)

    @pytest.mark.parametrize("backend", ["numpy", "numba"])
    def test_the_detector_refuses_a_rope_with_a_thick_end(self, backend):
        """A lollipop: every part of its curve lies on the mask, and it does not branch."""
        mask = np.zeros((240, 400), np.uint8)
        mask[116:124, 20:300] = 1
        cv2.circle(mask, (320, 120), 34, 1, -1)
        shape = ShapeDetector(Centerline(n=9), backend=backend).detect_mask(mask).shapes[0]
        assert not shape.ok
        assert shape.reason.endswith("it is no single rope")


class TestOutline:
    def test_a_piece_must_be_most_of_the_mask(self, kernels):
        for second, refused in ((60, False), (75, True)):
            mask = np.zeros(SIZE, np.uint8)
            mask[20:100, 20:120] = mask[20:100, 200 : 200 + second] = 1
            reason = judge_outline(region(mask, kernels), 0.1).reason
            assert ("falls into 2 pieces" in reason) is refused

    def test_an_outline_may_miss_its_samples_by_three_quarters(self, kernels):
        body = rope(kernels)
        assert judge_outline(body, 0.1) == ("", 1.0)
        assert judge_outline(body, 0.74).reason == ""
        assert judge_outline(body, 0.45).quality == pytest.approx(0.5**0.5)
        assert judge_outline(body, 0.76).reason == "the outline misses the mask's by 0.76 samples (at most 0.75)"

    def test_the_detector_tells_of_pieces(self):
        mask = np.zeros(SIZE, np.uint8)
        mask[20:100, 20:120] = mask[20:100, 200:290] = 1
        reason = ShapeDetector(Contour(n=9)).detect_mask(mask).shapes[0].reason
        assert reason == "the mask falls into 2 pieces, and the largest is 53% of it (at least 60%)"


class TestSheet:
    """A square sheet of 160 px and lattices over it, each wrong in one respect."""

    @pytest.fixture
    def body(self, kernels):
        mask = np.zeros((240, 320), np.uint8)
        mask[40:201, 80:241] = 1
        return region(mask, kernels)

    @staticmethod
    def lattice(body: Region, corners=((80, 40), (240, 40), (240, 200), (80, 200)), bow: float = 0.0) -> Patch:
        """Bilinear between the corners, 17 x 17; the upper side is bowed inwards by so many pixels."""
        at = np.linspace(0, 1, 17)
        v, u = (side[..., None] for side in np.meshgrid(at, at, indexing="ij"))
        first, second, third, fourth = np.array(corners, float)
        points = (1 - v) * ((1 - u) * first + u * second) + v * ((1 - u) * fourth + u * third)
        points[..., 1] += bow * np.sin(np.pi * u[..., 0]) * (1 - v[..., 0])
        flat = points.reshape(-1, 2)
        return Patch(flat, ~body.carries(flat), 17, kernels=body.kernels)

    def test_the_right_one_passes(self, body):
        assert judge_sheet(self.lattice(body), body, 10.0) == ("", pytest.approx(1.0, abs=0.02))

    @pytest.mark.parametrize(
        ("corners", "bow", "kink", "reason"),
        [
            (((60, 40), (240, 40), (240, 200), (60, 200)), 0, 0, "of the lattice lies off the mask (at most 10%)"),
            (((80, 40), (110, 190), (110, 200), (80, 50)), 0, 0, "a corner of the lattice has 1"),
            (
                ((80, 40), (240, 40), (240, 200), (80, 200)),
                0,
                61,
                "the outline turns by 61 degrees between two corners",
            ),
            (((80, 40), (240, 40), (240, 200), (80, 200)), 55, 0, "a side is 2"),
            (((90, 50), (230, 50), (165, 190), (155, 190)), 0, 0, "the areas of the lattice's cells vary by"),
        ],
    )
    def test_each_fault_is_refused_by_its_own_check(self, body, corners, bow, kink, reason):
        verdict = judge_sheet(self.lattice(body, corners, bow), body, kink)
        assert reason in verdict.reason
        assert verdict.quality == 0

    def test_a_lattice_that_folds_is_refused(self, body):
        lattice = self.lattice(body).lattice.copy()
        lattice[4:12, 4:12] = lattice[4:12, 11:3:-1]
        folded = Patch(lattice.reshape(-1, 2), np.zeros(289, bool), 17, kernels=body.kernels)
        assert "the lattice folds at" in judge_sheet(folded, body, 0.0).reason

    def test_quality_falls_with_kinks(self, body):
        assert judge_sheet(self.lattice(body), body, 45.0).quality < 0.75
