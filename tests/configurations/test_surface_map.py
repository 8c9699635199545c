"""The self-organising map of a surface: effect and limits of its epochs."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from sklearn.metrics import calinski_harabasz_score

from shape_obs import ShapeDetector, Surface
from tests.benchmarks.scenes.sheets import random_sheet


def lattice(mask: np.ndarray, epochs: int, ends: str = "tips") -> np.ndarray:
    shape = ShapeDetector([{"kind": "surface", "epochs": epochs, "ends": ends}]).detect_mask(mask).shapes[0]
    assert shape.ok, shape.reason
    return shape.pixels.reshape(4, 8, 2)


def clustering(mask: np.ndarray, centres: np.ndarray) -> float:
    """Return the Calinski-Harabasz score of the mask's pixels about centres."""
    pixels = np.argwhere(mask)[:, ::-1]
    nearest = np.argmin(np.linalg.norm(pixels[:, None] - centres.reshape(1, -1, 2), axis=2), axis=1)
    return float(calinski_harabasz_score(pixels, nearest))


@pytest.fixture
def trapezium() -> np.ndarray:
    """The cloth is wide at the left and narrow at the right: equal steps along its sides give unequal areas."""
    outline = np.array([[60, 40], [420, 130], [420, 210], [60, 300]], np.int32)
    return cv2.fillPoly(np.zeros((340, 480), np.uint8), [outline], 255)


def test_epochs_take_the_points_nearer_to_cluster_centres(trapezium):
    scores = [clustering(trapezium, lattice(trapezium, epochs, "centers")) for epochs in (0, 1, 3)]
    assert scores[0] < scores[1] < scores[2]


def test_epochs_leave_corners_on_corners(trapezium):
    before, after = lattice(trapezium, 0), lattice(trapezium, 3)
    moved = np.linalg.norm(after - before, axis=2)
    np.testing.assert_allclose(moved[[0, 0, -1, -1], [0, -1, -1, 0]], 0, atol=1e-3)
    assert moved[1:-1, 1:-1].max() > 2


@pytest.mark.parametrize("epochs", [1, 3])
def test_the_lattice_stays_right_and_near_its_material(epochs):
    rng = np.random.default_rng(8)
    for _ in range(8):
        sheet = random_sheet(rng, rng.uniform(1, 3), rng.uniform(0, 360))
        off = np.linalg.norm(lattice(sheet.mask, epochs) - lattice(sheet.mask, 0), axis=2)
        assert off.mean() < 3
        assert off.max() < 12


def test_the_number_of_epochs_is_checked():
    with pytest.raises(ValueError, match=r"surface: epochs must lie in 0...100, got -1"):
        Surface(epochs=-1)
