"""Recording: interruptions, lost cameras, slow encoders and full disks leave complete frames."""

from __future__ import annotations

import resource
import threading

import pytest
from noise_frames import camera_of, noise

from shape_obs.recording import Moment, Recording, RecordingWriter, record, writer
from shape_obs.source import SourceError


@pytest.mark.parametrize(
    ("error", "stopped"),
    [(KeyboardInterrupt(), "interrupted"), (SourceError("the cable was pulled"), "the cable was pulled")],
)
def test_a_recording_that_is_interrupted_or_whose_camera_is_lost_keeps_what_came(error, stopped, tmp_path):
    recorded = record(camera_of(noise(5), error), tmp_path / "r")
    assert (recorded.frames, recorded.stopped) == (5, stopped)
    recording = Recording(tmp_path / "r")
    assert (len(recording), recording.ended["stopped"], recording.warning) == (5, stopped, "")


def test_nothing_is_left_where_nothing_came(tmp_path):
    lost = camera_of(noise(1), SourceError("no camera"))
    with lost:
        lost.read()
    with pytest.raises(SourceError, match="no camera"):
        record(lost, tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_frames_that_were_missed_and_dropped_are_reported(tmp_path, monkeypatch):
    gaps = camera_of(noise(5, numbers=[7, 8, 11, 12, 14]), KeyboardInterrupt())
    assert record(gaps, tmp_path / "gaps").missed == 3
    gate, store = threading.Event(), writer.store
    monkeypatch.setattr(writer, "store", lambda *given: gate.wait(60) and store(*given))
    with RecordingWriter(tmp_path / "slow", camera_of(noise(1)), workers=1, pending=2) as slow:
        taken = [slow.add(Moment(frame), wait=False) for frame in noise(5)]
        gate.set()
    assert taken == [True, True, False, False, False]
    assert slow.frames == len(Recording(tmp_path / "slow")) == 2


def test_a_full_disk_is_reported_and_what_is_written_is_kept(tmp_path):
    """A limit on the size of files acts as a full disk: the line of some frame no longer fits."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    try:
        with pytest.raises(OSError, match=r"cannot write .*frames\.jsonl: .*; \d+ whole frames are kept in"):
            record(camera_of(noise(400, size=(4, 4)), live=False), tmp_path / "r", frames=400)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    recording = Recording(tmp_path / "r")
    assert 20 < len(recording) < 400
    assert not any(recording.check())
    with pytest.raises(FileExistsError, match="the folder is not empty"):
        record(camera_of(noise(1)), tmp_path / "r")
