"""The live view of a run draws the goals of all shapes."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser")

from deploy_parts import cell

from shape_obs.deploy import Still, deploy, view


def test_all_targets_are_drawn(monkeypatch):
    drawn: list[Any] = []

    def draw(rgb: Any, detection: Any, *, under: Any) -> Any:
        drawn.append(under)
        return rgb

    monkeypatch.setattr(view, "draw_detection", draw)
    lines = [np.full((3, 2), 10.0 * k, np.float32) for k in range(2)]
    targets = tuple(SimpleNamespace(points2d=line) for line in [*lines, None])
    page = view.LiveView(0, SimpleNamespace(targets=targets))
    try:
        env, *_ = cell()
        deploy(env, Still(), steps=5, on_step=page.show)
        for _ in range(100):
            if drawn:
                break
            time.sleep(0.05)
    finally:
        page.close()
    for (curve, colour), line in zip(drawn[0], lines, strict=True):
        assert colour == view.GOAL
        np.testing.assert_array_equal(curve, line)
