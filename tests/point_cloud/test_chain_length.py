"""A rope's curve in space: its depth and its length in metres."""

from __future__ import annotations

import numpy as np
import pytest

from shape_obs import Intrinsics
from shape_obs.frame import depth_images
from shape_obs.point_cloud.chain_length import lift_chain

CAMERA = Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5)
COUNT = 60


def lifted(
    z: np.ndarray,
    bridged: slice | None = None,
    expected: np.ndarray | None = None,
    slack: float = 0.02,
    beyond: int = 5,
):
    """Lift a level curve over 200 columns, whose depth is given for each of its points, and constant across it."""
    points = np.stack([np.linspace(60, 260, COUNT), np.full(COUNT, 120.0)], axis=1)
    depth = np.zeros((240, 320), np.float32)
    nearest = np.abs(np.arange(320)[:, None] - points[:, 0]).argmin(axis=1)
    depth[115:126] = (
        np.where(z[nearest] > 0, np.interp(np.arange(320), points[z > 0, 0], z[z > 0]), 0) if z.any() else 0
    )
    depth.flags.writeable = False
    mask = np.zeros((240, 320), np.uint8)
    mask[115:126, 60 - beyond : 261 + beyond] = 255
    left_out = np.zeros(COUNT, bool)
    if bridged is not None:
        left_out[bridged] = True
    known = np.zeros(0) if expected is None else expected
    return lift_chain(points, CAMERA.rays(points), left_out, depth_images(depth), mask, (0, 0), 11.0, known, slack)


@pytest.mark.parametrize("away", [0.0, 0.1, 0.4])
def test_the_length_of_a_rope_is_measured_at_any_tilt(away):
    x, z = (np.linspace(60, 260, COUNT) - 159.5) / 300.0, 0.6 + away * np.linspace(0, 1, COUNT)
    arc, smooth, share = lifted(z)
    true = np.linalg.norm(np.diff(np.stack([x * z, z], axis=1), axis=0), axis=1).sum()
    assert share == 1
    assert arc[-1] == pytest.approx(true, rel=0.01)
    np.testing.assert_allclose(smooth[2:-2], z[2:-2], atol=0.004)


def test_depth_at_a_tip_is_that_of_the_tip():
    """The mask ends there, and the pixels under the first point lie 1.5 pixels farther in on average: 3 mm nearer."""
    z = 0.6 + 0.4 * np.linspace(0, 1, COUNT)
    _, smooth, _ = lifted(z, beyond=0)
    assert smooth[[0, -1]] == pytest.approx(z[[0, -1]], abs=1e-3)


def test_a_bridged_piece_goes_straight_on():
    z = np.full(COUNT, 0.6)
    z[:25] -= 0.05 * np.linspace(1, 0, 25)
    z[45:] -= 0.05 * np.linspace(0, 1, 15)
    _, smooth, _ = lifted(z, bridged=slice(25, 45))
    np.testing.assert_allclose(smooth[27:43], 0.6, atol=2e-3)


def test_depth_of_another_strand_is_left_out_where_the_own_is_expected():
    z = np.full(COUNT, 0.6)
    z[25:35] = 0.5
    _, smooth, _ = lifted(z, expected=np.full(COUNT, 0.6))
    np.testing.assert_allclose(smooth, 0.6, atol=2e-3)


def test_depth_that_jumps_does_not_put_a_point_behind_the_camera():
    z = np.full(COUNT, 0.03)
    z[:1] = 1.0
    assert lifted(z)[1].min() > 0
    rng = np.random.default_rng(1)
    for _ in range(200):
        assert lifted(rng.choice([0.02, 0.3, 3.0], COUNT))[1].min() > 0
