"""Tables and recordings that were damaged or forged: a declared error, never other values or files from outside."""

from __future__ import annotations

import json
import os
import shutil
import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from fuzzing.recordings import a_table, damaged_recordings, flipped_tables, record_some, same

from shape_obs.ablation import load_study
from shape_obs.ablation.executors import Outcome, Task
from shape_obs.ablation.results import RunFolder, finished_runs
from shape_obs.ablation.scores import SCORES, Row, Score, scores_csv
from shape_obs.cli import main
from shape_obs.config.config_file import save_config
from shape_obs.recording import Recording, ShapeTable
from shape_obs.source import BadRecording

# ---- tables


@pytest.mark.parametrize("flips", [20, pytest.param(1000, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("suffix", [".parquet", ".npz", ".csv"])
def test_no_flipped_bit_loads_as_other_values(tmp_path, suffix, flips):
    if suffix == ".parquet":
        pytest.importorskip("pyarrow")
    found = flipped_tables(tmp_path, suffix, flips, seed=5)
    assert (found["wrong"], found["undeclared"]) == (0, 0)
    assert found.total() == flips


def test_files_of_other_programs_and_early_versions_are_read(tmp_path):
    """The checksum is missing, or was copied with the metadata of another file."""
    parquet = pytest.importorskip("pyarrow.parquet")
    a_table().save(tmp_path / "t.parquet")
    content = parquet.read_table(tmp_path / "t.parquet")
    parquet.write_table(content, tmp_path / "copied.parquet", compression="gzip")
    early = content.replace_schema_metadata({"shape_obs": content.schema.metadata[b"shape_obs"]})
    parquet.write_table(early, tmp_path / "early.parquet")
    a_table().save(tmp_path / "t.csv")
    note = tmp_path / "t.csv.meta.json"
    metadata = json.loads(note.read_text())
    assert metadata.pop("checksum").startswith("sha256:")
    note.write_text(json.dumps(metadata))
    for name in ("copied.parquet", "early.parquet", "t.csv"):
        assert same(ShapeTable.load(tmp_path / name), a_table()), name


def test_extract_verifies_what_it_keeps(tmp_path, capsys):
    """A part with a flipped bit is made again, with the same content."""
    pytest.importorskip("pyarrow")
    source = tmp_path / "recorded"
    for name in ("a", "b"):
        record_some(source / name)
    config = {"shapes": [{"kind": "contour", "n": 8}], "segmentation": {"kind": "gray", "low": 1}}
    save_config(tmp_path / "c.yaml", config)

    def extract() -> dict[str, Any]:
        with pytest.raises(SystemExit) as stop:
            main(["extract", str(source), "--config", str(tmp_path / "c.yaml"), "-o", str(tmp_path / "out"), "--json"])
        assert stop.value.code == 0
        return json.loads(capsys.readouterr().out)

    assert extract()["done"] == 2
    assert extract()["kept"] == 2
    part = min((tmp_path / "out").glob("part-a-*.parquet"))
    whole = part.read_bytes()
    for at in (100, len(whole) // 2, len(whole) - 300):
        part.write_bytes(whole[:at] + bytes([whole[at] ^ 4]) + whole[at + 1 :])
        report = extract()
        assert (report["done"], report["kept"]) == (1, 1), at
        assert part.read_bytes() == whole


def test_the_scores_of_a_finished_run_are_verified(tmp_path):
    (tmp_path / "study.yaml").write_text("version: 1\narms: {truth: {observation: truth}}")
    study = load_study(tmp_path / "study.yaml")
    rows = [Row(60, "", Score("near", seed, 50.25, 20.125, False, 1.0)) for seed in range(3)]
    run = RunFolder(tmp_path, "truth", 0)
    run.clear()
    about = {"ms_per_step": 1.0, "versions": {}}
    run.save(Outcome(Task(study, "truth", 0, run.path), {SCORES: scores_csv(rows).encode()}, about))
    assert finished_runs(study, tmp_path)[0].rows == tuple(rows)
    whole = (run.path / SCORES).read_text()
    for damaged in (whole.replace("50.25", "10.25"), whole[: whole.rindex("60,")]):
        (run.path / SCORES).write_text(damaged)
        with pytest.raises(ValueError, match=r"scores\.csv: damaged, its checksum differs from the one in run\.json"):
            finished_runs(study, tmp_path)


# ---- recordings


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole") / "recording"
    record_some(folder)
    assert not any(Recording(folder).check())
    return folder


@pytest.fixture
def folder(whole, tmp_path):
    """Return a copy of a recording that may be damaged."""
    return Path(shutil.copytree(whole, tmp_path / "recording"))


def change(folder: Path, line: int, **changes: Any) -> None:
    """Change fields of a line of ``frames.jsonl``."""
    path = folder / "frames.jsonl"
    lines = path.read_text().splitlines()
    lines[line] = json.dumps({**json.loads(lines[line]), **changes})
    path.write_text("\n".join(lines) + "\n")


def entry(folder: Path, line: int, kind: str = "rgb") -> dict[str, Any]:
    return json.loads((folder / "frames.jsonl").read_text().splitlines()[line])[kind]


def replace(folder: Path, line: int, kind: str, data: bytes) -> None:
    """Replace an image's file, with the right checksum of the file."""
    found = entry(folder, line, kind)
    (folder / found["file"]).write_bytes(data)
    change(folder, line, **{kind: {**found, "file_crc32": zlib.crc32(data)}})


def read(folder: Path) -> None:
    recording = Recording(folder)
    for i in range(len(recording)):
        _ = recording[i]


@pytest.mark.parametrize(
    "name",
    ["../secret.png", "/secret.png", "rgb/../../secret.png", "rgb/link.png", "link/secret.png", "..\\secret.png", "\0"],
)
def test_images_outside_of_the_recording_are_not_read(folder, tmp_path, name):
    """The image outside is valid and has the right checksums."""
    secret = tmp_path / "secret.png"
    shutil.copy(folder / "rgb" / "000000.png", secret)
    (folder / "rgb" / "link.png").symlink_to(secret)
    (folder / "link").symlink_to(tmp_path)
    file = str(secret) if name.startswith("/") else name
    change(folder, 1, rgb={**entry(folder, 0), "file": file})
    with pytest.raises(BadRecording, match=r"expected a path inside|outside of"):
        read(folder)


def test_a_pipe_in_a_recording_is_not_waited_for(folder):
    os.mkfifo(folder / "rgb" / "pipe.png")
    change(folder, 1, rgb={**entry(folder, 0), "file": "rgb/pipe.png"})
    with pytest.raises(BadRecording, match="expected a file"):
        read(folder)


def test_images_that_cannot_be_decoded(folder):
    for data in (b"", b"junk", (folder / "rgb" / "000001.png").read_bytes()[:40]):
        replace(folder, 1, "rgb", data)
        with pytest.raises(BadRecording, match=r"rgb/000001\.png: not an image that can be read"):
            read(folder)
    replace(folder, 1, "rgb", cv2.imencode(".png", np.zeros((12, 16), np.uint8))[1].tobytes())
    with pytest.raises(BadRecording, match=r"expected a rgb image, got shape \(12, 16\) of uint8"):
        read(folder)


def test_images_that_would_take_all_memory(folder):
    """The files have a few hundred bytes, and headers that claim gigabytes."""
    data = (folder / "rgb" / "000001.png").read_bytes()
    header = b"IHDR" + struct.pack(">II", 30_000, 30_000) + data[24:29]
    replace(folder, 1, "rgb", data[:12] + header + struct.pack(">I", zlib.crc32(header)) + data[33:])
    with pytest.raises(BadRecording, match="expected an image of at most 67108864 pixels, got 30000 x 30000"):
        read(folder)
    shutil.copytree(folder.parent / "recording", folder.parent / "other")
    other = folder.parent / "other"
    data = (other / "depth" / "000002.npy").read_bytes()
    shape = b"(12, 16)"
    replace(other, 2, "depth", data.replace(shape + b", }" + b" " * 12, b"(1200000, 160000), }   "))
    change(other, 1, rgb=entry(other, 0))
    with pytest.raises(BadRecording, match="its header announces 768000000000 bytes"):
        read(other)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rgb": "rgb/000001.png"}, "expected a mapping or a ImageEntry"),
        ({"episode": None}, "episode: expected int, got None"),
        ({"number": 2**70}, "number: expected an integer of 64 bits"),
        ({"stamp": float("nan")}, "stamp must be a finite number"),
        ({"stamp": 10**400}, "too large"),
        ({"anchors": {"gripper": [1, 2, 3, 4]}}, "anchors.gripper: expected"),
        ({"camera": {"intrinsics": {"width": 16}, "transform_camera_to_base": None}}, "missing height"),
        ({"anchors": json.loads("[" * 200 + "]" * 200)}, "nested too deep"),
    ],
)
def test_lines_with_wrong_values_are_named(folder, changes, message):
    change(folder, 1, **changes)
    with pytest.raises(BadRecording, match=rf"(?s)frames\.jsonl, line 2: damaged: .*{message}"):
        read(folder)


@pytest.mark.parametrize("count", [20, pytest.param(1500, marks=pytest.mark.nightly)])
def test_damaged_recordings_raise_only_bad_recording(tmp_path, count):
    found = damaged_recordings(tmp_path, count, seed=7)
    assert found["undeclared"] == 0
    assert found["refused"] > count / 2
