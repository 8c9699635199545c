"""Kill ``shape-obs ablate`` at random instants: finished runs stay, and a resumed study equals an undisturbed one."""

from __future__ import annotations

import pytest

pytest.importorskip("mujoco")
pytest.importorskip("stable_baselines3")

from fuzzing.killed_studies import killed_studies
from sweep import sweep

KILLS = sweep(0, 30)


@pytest.mark.long
@pytest.mark.skipif(not KILLS, reason="takes about ten minutes: set SHAPE_OBS_SWEEP=1")
def test_no_kill_loses_or_changes_a_finished_run(tmp_path):
    rows = killed_studies(tmp_path, KILLS)
    assert len(rows) == 3
    assert [row for row in rows if row["reached"] != "yes"] == []
