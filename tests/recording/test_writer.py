"""Recording: interruptions, lost cameras, slow encoders and full disks leave complete frames."""

from __future__ import annotations

import resource
import threading
from typing import Any

import pytest
from scripted_source import Script, noise

from shape_obs.recording import Moment, Recording, RecordingWriter, record
from shape_obs.source import SourceError


def test_a_recorder_that_is_interrupted_ends_cleanly(tmp_path):
    source: Any = Script(noise(5), KeyboardInterrupt())
    recorded = record(source, tmp_path / "r")
    assert (recorded.frames, recorded.stopped) == (5, "interrupted")
    assert Recording(tmp_path / "r").ended["stopped"] == "interrupted"


def test_a_camera_that_is_lost_leaves_what_came(tmp_path):
    source: Any = Script(noise(5), SourceError("the cable was pulled"))
    recorded = record(source, tmp_path / "r")
    assert (recorded.frames, recorded.stopped) == (5, "the cable was pulled")
    assert Recording(tmp_path / "r").warning == ""
    lost: Any = Script(noise(1), SourceError("no camera"))
    next(lost.left)
    with pytest.raises(SourceError, match="no camera"):
        record(lost, tmp_path / "none")
    assert not (tmp_path / "none").exists(), "and nothing where nothing came"


def test_frames_that_were_missed_and_dropped_are_reported(tmp_path, monkeypatch):
    source: Any = Script(noise(5, numbers=[7, 8, 11, 12, 14]), KeyboardInterrupt())
    assert record(source, tmp_path / "gaps").missed == 3
    source = Script(noise(1))
    with RecordingWriter(tmp_path / "slow", source, workers=1, pending=2) as writer:
        slow = gated_encoders(monkeypatch)
        taken = [writer.add(Moment(frame), wait=False) for frame in noise(5)]
        slow.set()
    assert taken == [True, True, False, False, False]
    assert writer.frames == 2
    assert len(Recording(tmp_path / "slow")) == 2


def gated_encoders(monkeypatch):
    """Make the encoders wait until the gate is set."""
    from shape_obs.recording import writer

    gate, store = threading.Event(), writer.store

    def waiting(*arguments):
        assert gate.wait(60)
        return store(*arguments)

    monkeypatch.setattr(writer, "store", waiting)
    return gate


def test_a_full_disk_is_reported_and_what_is_written_is_kept(tmp_path):
    """A limit on the size of files acts as a full disk: the line of some frame no longer fits."""
    source: Any = Script(noise(400, size=(4, 4)))
    source.live = False
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    try:
        with pytest.raises(OSError, match=r"cannot write .*frames\.jsonl: .*; \d+ whole frames are kept in"):
            record(source, tmp_path / "r", frames=400)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    recording = Recording(tmp_path / "r")
    assert 20 < len(recording) < 400
    assert not any(recording.check())


def test_a_recording_needs_an_empty_folder(tmp_path):
    source: Any = Script(noise(1))
    source.live = False
    record(source, tmp_path / "r", frames=1)
    with pytest.raises(FileExistsError, match="the folder is not empty"):
        record(source, tmp_path / "r")
