"""The initial form of a rope that hangs between two points."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("mujoco")

from shape_obs_envs.mujoco.bodies.strand import catenary_pitch


@pytest.mark.parametrize(("across", "up", "size"), [(0.1, 0.0, 0.5), (0.3, 0.19, 0.5), (0.4, -0.1, 0.45)])
def test_a_catenary_leads_from_one_end_to_the_other(across, up, size):
    steps = 5000
    pitch = catenary_pitch(across, up, size, (np.arange(steps) + 0.5) * size / steps)
    ends = np.array([np.cos(pitch).sum(), np.sin(pitch).sum()]) * size / steps
    np.testing.assert_allclose(ends, [across, up], atol=1e-6)
    assert (np.diff(pitch) > 0).all()
