"""Hostile and damaged bundles run no code, raise what is declared, and take little time and memory."""

from __future__ import annotations

import pytest


@pytest.mark.nightly
@pytest.mark.timeout(1200)
def test_a_bundle_is_data():
    pytest.importorskip("mujoco")
    pytest.importorskip("stable_baselines3")
    from fuzzing.bundles import bundle_claims

    rows = bundle_claims(mutated=300, every=1, kills=10)
    assert [row for row in rows if row["reached"] != "yes"] == []
    assert len(rows) == 15
