"""Recordings of librealsense return the same frames; each bad file raises one clear error."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from camera_scene import camera, picture, source

from shape_obs.source import BadRecording, EndOfSource
from shape_obs_envs.sources import RealSenseSource
from shape_obs_envs.sources.realsense.driver import recording_suffix

FRAMES = 60
REAL = Path(__file__).parents[5] / "shared" / "data" / "real" / "realsense_d4xx_single_640x480.bag"
OTHER = {".db3": ".bag", ".bag": ".db3"}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory):
    """Return a recording, and the frames that were read while it was made."""
    path = tmp_path_factory.mktemp("recording") / f"rope{recording_suffix()}"
    device = camera()
    frames = []
    with source(device, record_to=path) as stream:
        for number in range(FRAMES):
            device.push_raw(*picture(number), stamp=10 + number / 30)
            frames.append(stream.read(5))
        intrinsics = stream.intrinsics
    return path, frames, intrinsics


def test_a_recording_gives_the_same_frames(recorded) -> None:
    path, frames, intrinsics = recorded
    stream = RealSenseSource(recording=path)
    assert (stream.kind, stream.name, stream.live) == ("recording", str(path), False)
    for read in (stream.read, stream.read_latest):  # connected again, it begins again
        with stream:
            assert stream.intrinsics == intrinsics
            assert stream.serial == "455"
            for frame in frames:
                again = read()
                assert np.array_equal(_array(again.rgb), _array(frame.rgb))
                assert np.array_equal(_array(again.depth), _array(frame.depth))
                assert (again.stamp, again.number) == (pytest.approx(frame.stamp, abs=1e-6), frame.number)
            for _ in range(2):
                with pytest.raises(EndOfSource, match=f"{path.name}: end of the recording"):
                    read()


@pytest.mark.skipif(not REAL.is_file(), reason="the real recording is not available")
def test_the_recording_of_a_real_camera() -> None:
    with RealSenseSource(recording=REAL) as stream:
        frame = stream.read(10)
        intrinsics = stream.intrinsics
    assert intrinsics.size == (480, 640)
    assert not intrinsics.distorted
    assert (intrinsics.fx, intrinsics.fy) == pytest.approx((613.2, 613.4), abs=0.1)
    assert stream.name == str(REAL)
    assert frame.rgb is not None
    assert frame.depth is not None
    assert frame.rgb.std() > 20
    assert (frame.depth > 0).mean() > 0.9
    assert 300 < np.median(frame.depth[frame.depth > 0]) < 5000


def test_bad_files(recorded, tmp_path: Path) -> None:
    whole = recorded[0].read_bytes()
    suffix = recorded[0].suffix
    bad = {
        f"half{suffix}": (whole[: len(whole) // 2], "a part"),
        f"short{suffix}": (whole[:50], "a part|cannot read"),
        f"empty{suffix}": (b"", "the file is empty"),
        f"junk{suffix}": (b"hello" * 100, "got another file type"),
        f"rope{OTHER[suffix]}": (whole, f"the suffix is '{OTHER[suffix]}': rename it to rope{suffix}"),
        "rope.txt": (whole, f"rename it to rope{suffix}"),
    }
    for name, (content, message) in bad.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(BadRecording, match=message) as error:
            RealSenseSource(recording=tmp_path / name).connect()
        assert name in str(error.value)
    for path in (tmp_path / "none.db3", tmp_path):
        with pytest.raises(BadRecording, match="there is no such file"):
            RealSenseSource(recording=path).connect()


@pytest.mark.skipif(recording_suffix() != ".db3", reason="bags are written when they are closed")
def test_a_killed_recording_loses_nothing(tmp_path: Path) -> None:
    path = tmp_path / "killed.db3"
    code = (
        "import numpy as np, os, signal, time\n"
        "from shape_obs_envs.sources import RealSenseSource, SoftwareD455\n"
        "device = SoftwareD455(width=160, height=120)\n"
        f"stream = RealSenseSource(device, width=160, height=120, record_to={str(path)!r})\n"
        "stream.connect()\n"
        "for _ in range(20):\n"
        "    device.push_raw(np.zeros((120, 160, 3), np.uint8), np.full((120, 160), 700, np.uint16))\n"
        "    stream.read(5)\n"
        "time.sleep(0.5)\n"  # the recorder runs in a separate thread
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -signal.SIGKILL
    with RealSenseSource(recording=path) as stream:
        assert [stream.read(5).number for _ in range(19)] == list(range(1, 20))


def test_where_a_recording_may_go(tmp_path: Path) -> None:
    path = tmp_path / f"there{recording_suffix()}"
    path.write_bytes(b"precious")
    with pytest.raises(FileExistsError, match="exists already"):
        source(camera(), record_to=path).connect()
    assert path.read_bytes() == b"precious"
    with pytest.raises(ValueError, match=rf"writes {recording_suffix()} files"):
        source(camera(), record_to=tmp_path / "rope.mp4").connect()


def test_a_restart_goes_on_in_another_file(tmp_path: Path) -> None:
    path, device = tmp_path / f"rope{recording_suffix()}", camera()
    with source(device, record_to=path, patience=0.05, recover_timeout=30) as stream:
        for number in range(3):
            device.push_raw(*picture(), number / 30)
            stream.read(5)
        second = path.with_name(f"rope-2{path.suffix}")
        deadline = time.monotonic() + 20
        while not second.exists() and time.monotonic() < deadline:
            time.sleep(0.01)
        assert second.exists()
    with RealSenseSource(recording=path) as again:
        assert again.read(5).number == 1


def _array(image: np.ndarray | None) -> np.ndarray:
    assert image is not None
    return image
