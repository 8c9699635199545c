"""``shape-obs record`` and ``shape-obs replay`` as people and programs use them."""

from __future__ import annotations

import json
import shutil

import cv2
import numpy as np
import pytest
from noise_frames import camera_of

from shape_obs import Frame, save_config
from shape_obs.cli import main
from shape_obs.recording import Moment, Recording, RecordingWriter, ShapeTable

BLUE = {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]}
ENV = "record --source ShapeObs/Cable-v0 -o new --set renderer=rays"
SEEDS = ("'abc'", "-1", "1.5", "True")
CABLE = ["--set", "actions=random", "seed=2", "renderer=rays", "camera=[96, 72]"]


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Return a folder with configs, photos, and various damaged files."""
    folder = tmp_path_factory.mktemp("place")
    save_config(folder / "pixels.yaml", {"segmentation": BLUE, "shapes": [{"kind": "centerline", "n": 8}]})
    space = {"kind": "centerline", "n": 8, "anchor": "gripper0", "ends": "tips", "spacing": "m"}
    save_config(folder / "space.yaml", {"segmentation": BLUE, "shapes": [space], "features": ["points3d"]})
    for name, count in (("photos", 3), ("damaged", 2)):
        (folder / name).mkdir()
        for i in range(count):
            rgb = np.full((72, 96, 3), 190, np.uint8)
            cv2.line(rgb, (10, 30 + 4 * i), (80, 40), (200, 60, 30), 6)
            cv2.imwrite(str(folder / name / f"{i}.png"), rgb)
    data = (folder / "damaged" / "1.png").read_bytes()
    (folder / "damaged" / "1.png").write_bytes(data[: len(data) // 2])
    (folder / "notes.txt").write_text("notes")
    (folder / "junk.mp4").write_bytes(b"no video" * 100)
    writer = cv2.VideoWriter(str(folder / "rope.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (96, 72))
    for i in range(3):
        writer.write(np.asarray(cv2.imread(str(folder / "photos" / f"{i}.png"))))
    writer.release()
    return folder


@pytest.fixture(scope="module")
def recorded(place):
    """Return twelve frames of the simulated cable."""
    pytest.importorskip("mujoco")
    with pytest.raises(SystemExit) as stop:
        main(["record", "--source", "ShapeObs/Cable-v0", "-o", str(place / "cable"), "--frames", "12", *CABLE])
    assert stop.value.code == 0
    return place / "cable"


def test_record_then_replay_then_read(place, recorded, tmp_path, run):
    pytest.importorskip("pyarrow")
    code, out, err = run(
        "replay", recorded, "--config", place / "space.yaml", "--verify", "--json",
        "--csv", tmp_path / "s.csv", "--npz", tmp_path / "s.npz", "--parquet", tmp_path / "s.parquet",
        "--video", tmp_path / "s.mp4",
    )  # fmt: skip
    report = json.loads(out)
    assert code == 0
    assert "replaying" in err, "a progress bar"
    assert (report["verified"], report["frames"], report["shapes"]["centerline"]["ok"]) == (12, 12, 12)
    tables = [ShapeTable.load(tmp_path / f"s.{suffix}") for suffix in ("csv", "npz", "parquet")]
    for table in tables:
        assert table["centerline/points3d"].shape == (12, 8, 3)
        assert np.array_equal(table["centerline/points3d"], tables[0]["centerline/points3d"])
        assert table.metadata["config_hash"] == report["config_hash"]
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"s.csv", "s.csv.meta.json", "s.mp4", "s.npz", "s.parquet"}, "nothing half-written stays"


def test_replaying_the_source_itself_gives_the_recordings_shapes(place, recorded, tmp_path, run):
    for source, options, name in ((recorded, [], "a.npz"), ("ShapeObs/Cable-v0", ["--frames", 12, *CABLE], "b.npz")):
        code, out, _ = run("replay", source, "--config", place / "space.yaml", "--npz", tmp_path / name, *options)
        assert code == 0
        assert "ok in 12" in out
    a, b = (ShapeTable.load(tmp_path / name) for name in ("a.npz", "b.npz"))
    for column in a.columns:
        if column != "received":
            assert np.array_equal(a[column], b[column], equal_nan=a[column].dtype.kind == "f"), column


def test_seconds_are_those_of_the_stamps(place, tmp_path, run):
    pytest.importorskip("mujoco")
    arguments = ["--source", "ShapeObs/Cable-v0", "-o", tmp_path / "r", "--seconds", 0.5, "--json", *CABLE]
    code, out, _ = run("record", *arguments)
    report = json.loads(out)
    assert code == 0
    assert (report["frames"], report["dropped"], report["stopped"]) == (10, 0, "done")
    assert report["seconds"] == pytest.approx(0.45)


def test_stamps_in_milliseconds_or_that_stand_still_are_said_once(place, tmp_path, run):
    rgb = np.asarray(cv2.imread(str(place / "photos" / "0.png")))
    frames = [Frame(rgb, stamp=33.3 * min(i, 6), number=i) for i in range(8)]
    with RecordingWriter(tmp_path / "a", camera_of(frames)) as writer:
        for frame in frames:
            writer.add(Moment(frame))
    code, out, err = run("record", "--source", tmp_path / "a", "-o", tmp_path / "b", "--seconds", 250)
    assert (code, err.count("milliseconds")) == (0, 1)
    assert "8 frames, 199.83 s" in out, "where the stamp stands still, time goes on"
    code, out, err = run("replay", tmp_path / "b", "--config", place / "pixels.yaml")
    assert (code, err.count("milliseconds")) == (0, 1)
    assert "1 x      the stamp stands still" in out


def test_photos_and_videos_are_recorded_and_replayed(place, tmp_path, run):
    for source in ("photos", "rope.avi"):
        code, out, _ = run("record", "--source", place / source, "-o", tmp_path / source, "--json")
        assert (code, json.loads(out)["frames"]) == (0, 3)
        assert not Recording(tmp_path / source).has_depth
        code, out, _ = run("replay", tmp_path / source, "--config", place / "pixels.yaml", "--json")
        assert (code, json.loads(out)["shapes"]["centerline"]["ok"]) == (0, 3)


def test_a_shape_that_is_not_there_is_a_row(recorded, tmp_path, run):
    red = {**BLUE, "low": [0, 200, 200], "high": [5, 255, 255]}
    save_config(tmp_path / "red.yaml", {"segmentation": red, "on_missing": "raise"})
    code, out, _ = run("replay", recorded, "--config", tmp_path / "red.yaml", "--npz", tmp_path / "s.npz")
    table = ShapeTable.load(tmp_path / "s.npz")
    assert code == 0
    assert "12 x      the mask is empty" in out
    assert len(table) == 12
    assert not table["centerline/ok"].any()
    assert np.isnan(table["centerline/points3d"]).all()


def test_an_interrupted_recording_is_replayed_with_a_word_about_it(place, recorded, tmp_path, run):

    shutil.copytree(recorded, tmp_path / "cut")
    text = (tmp_path / "cut" / "frames.jsonl").read_bytes()
    (tmp_path / "cut" / "frames.jsonl").write_bytes(text[: len(text) // 2])
    code, out, err = run("replay", tmp_path / "cut", "--config", place / "space.yaml", "--json")
    whole = text[: len(text) // 2].count(b"\n")
    assert code == 0
    assert json.loads(out)["frames"] == whole
    line = f"shape-obs replay: {tmp_path / 'cut'}: the recording was interrupted; its {whole} whole frames are read"
    assert line in err


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        ("replay none --config pixels.yaml", 1, "source 'none' is not a camera, path, class or environment"),
        ("replay junk.mp4 --config pixels.yaml", 1, "junk.mp4: not a video that OpenCV can decode"),
        ("replay damaged --config pixels.yaml", 1, "1.png: not an image that can be read; it may be damaged"),
        ("replay rope.avi --config space.yaml", 1, "rope.avi has no depth, but the config needs it: feature"),
        ("replay photos", 2, "give --config FILE or --policy FILE to detect with"),
        ("replay CartPole-v1 --config pixels.yaml", 1, "CartPole-v1: the observation must be an RGB image"),
        ("replay ShapeObs/Cable-v0 --config space.yaml", 2, "ShapeObs/Cable-v0 never ends: give --frames N"),
        ("record --source rope.avi -o new --depth yes", 1, "rope.avi has no depth to record"),
        ("record --source photos -o new --seconds 1", 1, "its frames have no stamps"),
        *((f"{ENV} seed={seed}", 2, f"seed: expected a whole number, 0 or more, got {seed}") for seed in SEEDS),
        (f"{ENV} render_mode=human", 1, "there is no display"),
        (f"{ENV} render_mode=x", 2, "render_mode: expected one of None, 'rgb_array'"),
        (f"{ENV} render_mode=1", 2, "'int' object has no attribute"),
        (f"{ENV} rederer=rays", 2, "did you mean 'renderer'?"),
        (f"{ENV} max_episode_steps=abc", 2, "`max_episode_steps` to be"),
        ("record --source ShapeObs/D455-v0 -o new --set rate=abc", 2, "rate: expected steps per second above 0"),
        ("record --source ShapeObs/D455-v0 -o new --set size=5", 2, "size: expected [width, height]"),
        ("record --source d455 -o new --set expsure=1", 2, "did you mean 'exposure'?"),
    ],
)
def test_bad_input_gets_one_clear_line(place, run, monkeypatch, arguments, code, message):
    monkeypatch.chdir(place)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    before = sorted(place.rglob("*"))
    ended, out, err = run(*arguments.split())
    (line,) = [line for line in err.replace("\r", "\n").splitlines() if line.startswith("shape-obs")]
    assert (ended, out) == (code, "")
    assert message in line
    assert [path for path in sorted(place.rglob("*")) if path not in before] == []


def test_verify_names_all_that_is_damaged(recorded, tmp_path, run):

    shutil.copytree(recorded, tmp_path / "r")
    for name in ("rgb/000001.png", "depth/000005.png"):
        (tmp_path / "r" / name).write_bytes(b"junk")
    code, out, err = run("replay", tmp_path / "r", "--verify")
    assert (code, out) == (1, "")
    assert "2 of 12 frames are damaged" in err
    assert "rgb/000001.png" in err
    assert "depth/000005.png" in err


def test_what_systems_and_editors_leave_in_folders_is_skipped(place, tmp_path, run, monkeypatch):
    pytest.importorskip("pyarrow")
    monkeypatch.chdir(tmp_path)
    shutil.copytree(place / "photos", "all/photos")
    extract = ("extract", "a*", "--config", place / "pixels.yaml", "-o", "shapes", "--json")
    assert json.loads(run(*extract)[1])["done"] == 1
    for folder in ("all", "all/photos", "new"):
        (tmp_path / folder / "__MACOSX" / "photos").mkdir(parents=True)
        names = "._0.png .DS_Store Thumbs.db desktop.ini 0.png~ .0.png.swp #1.png# Icon\r .a.avi .b.mcap x.bak"
        for name in (*names.split(" "), "__MACOSX/photos/._0.png", "__MACOSX/0.png"):
            (tmp_path / folder / name).write_bytes(b"no picture")
    kept = json.loads(run(*extract)[1])
    assert (kept["kept"], kept["done"], kept["failed"]) == (1, 0, []), "what was left changes no recording"
    code, out, err = run("record", "--source", "all/photos", "-o", "new", "--json")
    assert (code, json.loads(out or "{}").get("frames")) == (0, 3), err
