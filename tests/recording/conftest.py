"""A recording of the simulated cable, and a log of its shapes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from recorded_cable import CABLE, CONFIG, FRAMES, OPTIONS, detector

from shape_obs.recording import ShapeLog, record, replay
from shape_obs.recording.format import read_moments
from shape_obs_envs.sources import EnvSource, FolderSource


@pytest.fixture(scope="session")
def cable():
    pytest.importorskip("mujoco")
    with EnvSource(CABLE, **OPTIONS) as source:
        return list(read_moments(source, FRAMES))


@pytest.fixture(scope="session")
def recorded(cable, tmp_path_factory):
    """Return the same frames, recorded by another run of the same environment."""
    folder = tmp_path_factory.mktemp("cable") / "recording"
    with EnvSource(CABLE, **OPTIONS) as source:
        summary = record(source, folder, frames=FRAMES)
    assert (summary.frames, summary.missed, summary.dropped, summary.stopped) == (FRAMES, 0, 0, "done")
    return folder


@pytest.fixture(scope="session")
def log(recorded):
    """Return a log of the recording whose last three frames are black, so that the rope is lost."""
    finder = detector()
    with FolderSource(recorded) as source:
        log = ShapeLog(finder, CONFIG, source)
        pairs = list(replay(source, finder))
        for moment, detection in pairs:
            log.add(moment, detection)
        for i in range(3):
            moment = pairs[-1][0]
            frame: Any = moment.frame
            black, stamp = np.zeros_like(frame.rgb), frame.stamp + 0.4 * (i + 1)
            log.add(moment, finder.detect(black, frame.depth, frame.camera, stamp=stamp, anchors=moment.anchors))
    return log, pairs
