"""A running robot logs its steps to rerun, and never waits for it."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rerun")

from deploy_parts import PATIENT, Always, cell
from rerun_reading import points, read_rrd

from shape_obs.deploy import deploy
from shape_obs.deploy.rerun_view import RerunView
from shape_obs.drawing.rerun_stream import RerunStream


def test_steps_are_logged_with_shapes_actions_goals_and_decisions(tmp_path):
    env, *_ = cell()
    env.targets = (SimpleNamespace(points2d=np.array([[5.0, 6.0], [7.0, 8.0]], np.float32)),)
    seen = {}
    with RerunStream(tmp_path / "run.rrd") as stream:
        view = RerunView(stream.recording, env)

        def show(step):
            seen[step.step] = step
            view.show(step)

        report = deploy(env, Always(), PATIENT, steps=20, on_step=show)
        view.close()
    assert report.acted == 20
    name = next(iter(seen.values())).detection.shapes[0].name
    logged = read_rrd(tmp_path / "run.rrd", f"/camera/image/shapes/{name}/points", "Points2D:positions")
    assert max(logged) == 19, "the last step is never left out"
    for number, values in logged.items():
        np.testing.assert_array_equal(points(values), seen[number].detection[name].points2d)
    actions = read_rrd(tmp_path / "run.rrd", "/plots/features/action", "Scalars:scalars")
    assert actions[19] == [1.0, 0.0]
    goals = read_rrd(tmp_path / "run.rrd", "/camera/image/goals", "LineStrips2D:strips")
    np.testing.assert_array_equal(goals[19], [[[5, 6], [7, 8]]])
    texts = [text for value in read_rrd(tmp_path / "run.rrd", "/log", "TextLog:text").values() for text in value]
    assert "loop: act" in texts


def test_a_loop_goes_on_while_the_log_hangs(monkeypatch):
    hang = threading.Event()
    env, *_ = cell()
    view = RerunView(None, env)
    monkeypatch.setattr(view._log, "log", lambda *_, **__: hang.wait(30))
    report = deploy(env, Always(), PATIENT, steps=20, on_step=view.show)
    assert (report.steps, report.acted) == (20, 20)
    assert report.seconds < 10
    hang.set()
    view.close()
