"""A camera recorded in both formats and replayed gives the same shapes, bit for bit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from camera_scene import camera, source

from shape_obs import ShapeDetector, save_config
from shape_obs.bench.scenes import draw_rope
from shape_obs.cli import main
from shape_obs.recording import Moment, RecordingWriter, ShapeLog, ShapeTable
from shape_obs_envs.sources.realsense.driver import recording_suffix

CONFIG: dict[str, Any] = {
    "shapes": [{"kind": "centerline", "n": 12, "spacing": "m"}],
    "segmentation": {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]},
}
FRAMES = 12


def rope(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Return raw images of a rope that moves over a table: (120, 160, 3) uint8 and (120, 160) uint16 mm."""
    t = np.linspace(0, 1, 200)
    mask = draw_rope(np.stack([40 + 80 * t, 60 + number + 15 * np.sin(5 * t)], axis=1), 7.0, size=(120, 160)).mask > 0
    rgb = np.where(mask[..., None], (30, 60, 200), (190, 185, 180)).astype(np.uint8)
    return rgb, np.full((120, 160), 700, np.uint16)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, ShapeTable]:
    """Return a folder with a config and both recordings, and the live detections."""
    folder = tmp_path_factory.mktemp("camera")
    save_config(folder / "shape.yaml", CONFIG)
    raw, device, detector = folder / f"rope{recording_suffix()}", camera(), ShapeDetector(**CONFIG)
    with source(device, record_to=raw) as stream:
        log = ShapeLog(detector, CONFIG, stream)
        with RecordingWriter(folder / "rope", stream) as writer:
            for number in range(FRAMES):
                device.push_raw(*rope(number), stamp=1_700_000_000 + number / 30)
                moment = Moment(stream.read(5))
                writer.add(moment)
                frame = moment.frame
                log.add(moment, detector.detect(frame.rgb, frame.depth, frame.camera, stamp=frame.stamp))
    return folder, raw, log.table()


@pytest.mark.parametrize("way", ["folder", "file"])
def test_the_same_shapes_from_both_kinds_of_recording(place, tmp_path, way):
    folder, raw, live = place
    recording = folder / "rope" if way == "folder" else raw
    with pytest.raises(SystemExit) as stop:
        main(["replay", str(recording), "--config", str(folder / "shape.yaml"), "--npz", str(tmp_path / "s.npz")])
    assert stop.value.code == 0
    table = ShapeTable.load(tmp_path / "s.npz")
    assert live["centerline/ok"].all()
    for name, column in live.columns.items():
        if name != "received":
            assert np.array_equal(table[name], column, equal_nan=column.dtype.kind == "f"), name


def test_a_cut_file_gets_one_clear_line(place, tmp_path, capsys):
    folder, raw, _ = place
    cut = tmp_path / raw.name
    cut.write_bytes(raw.read_bytes()[: raw.stat().st_size // 2])
    with pytest.raises(SystemExit) as stop:
        main(["replay", str(cut), "--config", str(folder / "shape.yaml")])
    (line,) = [line for line in capsys.readouterr().err.replace("\r", "\n").splitlines() if "shape-obs" in line]
    assert stop.value.code == 1
    reason = line.removeprefix(f"shape-obs replay: {cut}: ")
    assert reason.startswith(("a part", "librealsense cannot read"))  # of a .db3, of a .bag
