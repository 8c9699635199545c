"""Hostile and damaged bundles run no code, raise what is declared, and take little time and memory."""

from __future__ import annotations

import pytest

pytest.importorskip("mujoco")
pytest.importorskip("stable_baselines3")

from fuzzing.bundles import bundle_claims
from sweep import sweep


@pytest.mark.long
def test_a_bundle_is_data():
    rows = bundle_claims(mutated=sweep(30, 1000), every=1 if sweep(0, 1) else 8, kills=sweep(4, 30))
    assert [row for row in rows if row["reached"] != "yes"] == []
    assert len(rows) == 15
