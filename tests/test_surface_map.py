"""A surface's self-organising map: what its epochs change, and what they leave alone."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from shape_obs import ShapeDetector, Surface
from shape_obs.evaluation.sheets import random_sheet


def lattice(mask: np.ndarray, epochs: int, ends: str = "tips") -> np.ndarray:
    shape = ShapeDetector([{"kind": "surface", "epochs": epochs, "ends": ends}]).detect_mask(mask).shapes[0]
    assert shape.ok, shape.reason
    return shape.pixels.reshape(4, 8, 2)


def share_of_pixels(mask: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """(32,) how many of the mask's pixels are nearest to each centre, in units of their mean."""
    pixels = np.argwhere(mask)[:, ::-1]
    nearest = np.argmin(np.linalg.norm(pixels[:, None] - centres.reshape(1, -1, 2), axis=2), axis=1)
    count = np.bincount(nearest, minlength=32)
    return count / count.mean()


@pytest.fixture
def trapezium() -> np.ndarray:
    """Wide at the left, narrow at the right: equal steps along its sides give unequal areas."""
    outline = np.array([[60, 40], [420, 130], [420, 210], [60, 300]], np.int32)
    return cv2.fillPoly(np.zeros((340, 480), np.uint8), [outline], 255)


def test_epochs_even_the_areas_out(trapezium):
    uneven = [share_of_pixels(trapezium, lattice(trapezium, epochs, "centers")).std() for epochs in (0, 1, 3)]
    assert uneven[0] > uneven[1] > uneven[2]
    assert uneven[2] < 0.8 * uneven[0]


def test_epochs_leave_the_border_alone(trapezium):
    before, after = lattice(trapezium, 0), lattice(trapezium, 3)
    border = np.ones((4, 8), bool)
    border[1:-1, 1:-1] = False
    np.testing.assert_allclose(after[border], before[border], atol=1e-3)
    assert np.linalg.norm(after - before, axis=2)[~border].max() > 3


@pytest.mark.parametrize("epochs", [1, 3])
def test_the_lattice_stays_right_and_near_its_material(epochs):
    rng = np.random.default_rng(8)
    for _ in range(8):
        sheet = random_sheet(rng)
        off = np.linalg.norm(lattice(sheet.mask, epochs) - lattice(sheet.mask, 0), axis=2)
        assert off.mean() < 3
        assert off.max() < 12


def test_the_number_of_epochs_is_checked():
    with pytest.raises(ValueError, match=r"surface: epochs must lie in 0...100, got -1"):
        Surface(epochs=-1)
