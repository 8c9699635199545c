"""Contours of closed bands: an occluder is reported."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from shape_obs import Contour, ShapeDetector
from tests.benchmarks.scenes.blobs import KINDS, random_blob


def one(mask: np.ndarray, **kwargs: Any) -> Any:
    return ShapeDetector([Contour(**kwargs)]).detect_mask(mask).shapes[0]


class TestRing:
    @staticmethod
    def band(covered: tuple[int, int] = (0, 0)) -> np.ndarray:
        """Return a band about (120, 100) of which a sector, in degrees, is covered."""
        mask = np.zeros((200, 240), np.uint8)
        cv2.ellipse(mask, (120, 100), (80, 60), 10, 0, 360, 255, 14)
        if covered[0] != covered[1]:
            cv2.ellipse(mask, (120, 100), (110, 90), 10, *covered, 0, -1)
        return mask

    def test_a_closed_band_is_taken_and_a_covered_one_is_reported(self):
        assert one(self.band(), ring=True).ok
        for covered in ((20, 40), (90, 91), (200, 290)):
            assert one(self.band(covered), ring=False).quality > 0.5  # for all that is known it may be open
            shape = one(self.band(covered), ring=True)
            assert not shape.ok
            assert shape.reason == "the mask encloses no hole: something lies over the ring, or it is open"

    def test_a_track_goes_on_after_the_hand(self):
        detector = ShapeDetector([Contour(ring=True)])
        before = detector.detect_mask(self.band()).shapes[0]
        assert detector.detect_mask(self.band((20, 60))).shapes[0].reason
        after = detector.detect_mask(self.band()).shapes[0]
        np.testing.assert_allclose(after.pixels, before.pixels, atol=1.0)

    @pytest.mark.parametrize("kind", KINDS)
    def test_what_is_filled_is_no_ring(self, kind):
        for seed in range(5):
            assert not one(random_blob(np.random.default_rng(seed), kind).mask, ring=True).ok

    def test_specks_in_the_mask_make_no_ring(self):
        mask = self.band((20, 60))
        mask[np.random.default_rng(0).random(mask.shape) < 0.01] = 0
        assert not one(mask, ring=True).ok
