"""The live page and rerun show a run, and the loop never waits for them."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any
from urllib.request import urlopen

import numpy as np
import pytest
from fake_cell import PATIENT, Always, cell

from shape_obs.deploy import Still, deploy


def test_the_page_draws_the_goals_of_all_shapes_and_writes_nothing_to_stdout(monkeypatch, capsys):
    pytest.importorskip("viser")
    from shape_obs.deploy import view

    drawn: list[Any] = []
    shown = threading.Event()

    def draw(rgb: Any, detection: Any, *, scale: int, under: Any) -> Any:
        drawn.append(under)
        shown.set()
        return rgb

    monkeypatch.setattr(view, "draw_detection", draw)
    lines = [np.full((3, 2), 10.0 * k, np.float32) for k in range(2)]
    targets = tuple(SimpleNamespace(points2d=line) for line in [*lines, None])
    page = view.LiveView(0, SimpleNamespace(targets=targets))
    try:
        with urlopen(page.url, timeout=10) as answer:
            assert answer.status == 200
        assert deploy(cell()[0], Still(), steps=10, on_step=page.show).steps == 10
        assert shown.wait(10)
    finally:
        page.close()
    for (curve, colour), line in zip(drawn[0], lines, strict=True):
        assert colour == view.GOAL
        np.testing.assert_array_equal(curve, line)
    assert capsys.readouterr().out == ""


def test_steps_are_logged_to_rerun_with_shapes_actions_goals_and_decisions(tmp_path):
    pytest.importorskip("rerun")
    from rerun_reading import points, read_rrd

    from shape_obs.deploy.view import RerunView
    from shape_obs.drawing.rerun_stream import RerunStream

    env, *_ = cell()
    env.targets = (SimpleNamespace(points2d=np.array([[5.0, 6.0], [7.0, 8.0]], np.float32)),)
    seen = {}
    with RerunStream(tmp_path / "run.rrd") as stream:
        view = RerunView(stream.recording, env)

        def show(step):
            seen[step.step] = step
            view.show(step)

        assert deploy(env, Always(), PATIENT, steps=20, on_step=show).acted == 20
        view.close()
    name = seen[0].detection.shapes[0].name
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


def test_a_loop_goes_on_while_rerun_hangs(monkeypatch):
    pytest.importorskip("rerun")
    from shape_obs.deploy.view import RerunView

    hang = threading.Event()
    env, *_ = cell()
    view = RerunView(None, env)
    monkeypatch.setattr(view._log, "log", lambda *_, **__: hang.wait(30))
    assert deploy(env, Always(), PATIENT, steps=20, on_step=view.show).acted == 20
    hang.set()
    view.close()
