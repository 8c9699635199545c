"""Streams to files are complete or absent, and a viewer that goes away stops nothing."""

from __future__ import annotations

import socket
import subprocess
import sys
import time

import numpy as np
import pytest
from installed import needs
from rerun_reading import read_rrd

from shape_obs.drawing import RerunLog
from shape_obs.drawing.rerun_stream import RerunStream, address

pytestmark = needs("rerun")

SERVER = """
import sys, time, rerun
viewer = rerun.RecordingStream("viewer")
viewer.serve_grpc(grpc_port=int(sys.argv[1]))
time.sleep(60)
"""
IMAGE = np.zeros((12, 16, 3), np.uint8)


def fill(stream, frames=3, then=None):
    log = RerunLog(stream.recording)
    for k in range(frames):
        log.log(None, IMAGE, number=k)
    if then is not None:
        raise then


def test_a_file_appears_when_it_is_complete(tmp_path):
    path = tmp_path / "new" / "log.rrd"
    with RerunStream(path) as stream:
        fill(stream)
        assert not path.exists()
    assert list(read_rrd(path, "/camera/image/rgb", "EncodedImage:blob")) == [0, 1, 2]
    assert [entry.name for entry in path.parent.iterdir()] == ["log.rrd"]


def test_an_error_leaves_the_old_file(tmp_path):
    path = tmp_path / "log.rrd"
    path.write_bytes(b"old")
    with pytest.raises(ValueError, match="wrong"), RerunStream(path) as stream:
        fill(stream, then=ValueError("wrong"))
    assert path.read_bytes() == b"old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["log.rrd"]


def test_after_ctrl_c_the_file_holds_what_was_logged(tmp_path):
    path = tmp_path / "log.rrd"
    with pytest.raises(KeyboardInterrupt), RerunStream(path) as stream:
        fill(stream, then=KeyboardInterrupt())
    assert list(read_rrd(path, "/camera/image/rgb", "EncodedImage:blob")) == [0, 1, 2]


@pytest.mark.parametrize(
    ("target", "error", "message"),
    [
        ("log.txt", ValueError, "expected FILE.rrd or an address such as .*, got 'log.txt'"),
        ("no.rrd/log.rrd", OSError, "cannot make the output folder"),
    ],
)
def test_bad_targets(tmp_path, monkeypatch, target, error, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "no.rrd").write_text("a file")
    with pytest.raises(error, match=message):
        RerunStream(target)


def test_a_viewer_that_is_not_there_is_an_error_and_one_that_goes_away_stops_nothing():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with pytest.raises(OSError, match=f"no rerun viewer at rerun\\+http://127.0.0.1:{port}/proxy"):
        RerunStream(address("127.0.0.1", port))
    viewer = subprocess.Popen([sys.executable, "-c", SERVER, str(port)])
    try:
        for _ in range(200):  # until it accepts connections
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    break
            time.sleep(0.1)
        with RerunStream(address("127.0.0.1", port)) as stream:
            fill(stream, 20)
            viewer.kill()
            viewer.wait()
            fill(stream, 200)
    finally:
        viewer.kill()
        viewer.wait()
