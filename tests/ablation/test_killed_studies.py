"""Kill ``shape-obs ablate`` at random instants: finished runs stay, and a resumed study equals an undisturbed one."""

from __future__ import annotations

import pytest


@pytest.mark.nightly
@pytest.mark.timeout(1200)
def test_no_kill_loses_or_changes_a_finished_run(tmp_path):
    pytest.importorskip("mujoco")
    pytest.importorskip("stable_baselines3")
    from fuzzing.killed_studies import killed_studies

    killed = killed_studies(tmp_path, kills=10)
    assert killed.kills == 10
    assert killed.finished >= 1
    assert (killed.lost, killed.different) == (0, 0)
