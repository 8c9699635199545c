"""Settings that pages share: clicks, sliders, undo, refusals, saving, and controls for rules of other packages."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass

import cv2
import numpy as np
import pytest

from shape_obs import Frame, ShapeDetector, load_config, save_config
from shape_obs.config.config_file import detector_arguments
from shape_obs.image.segmentation import HSVRange, Segmentation
from shape_obs.tuner.controls import controls_of
from shape_obs.tuner.session import Session

OFF = (10.0, 10.0)  # a pixel of ``blue`` on the table


@pytest.fixture
def frame(blue):
    return Frame(blue)


@pytest.fixture
def clicked(frame, wave):
    session = Session()
    assert session.click(frame, on(wave)), session.error
    return session


def on(rope) -> tuple[float, float]:
    """Return a pixel in the middle of a rope."""
    v, u = np.argwhere(cv2.erode(rope.mask, np.ones((5, 5), np.uint8)) > 0)[200]
    return float(u), float(v)


def test_a_click_finds_the_rope(clicked, blue, wave):
    shape = clicked.detector.detect(blue).shapes[0]
    assert shape.ok, shape.reason
    u, v = np.rint(shape.points2d).astype(int).T
    assert (wave.mask[v, u] > 0).all()
    assert clicked.settings.text
    assert len(clicked.settings.picks) == 1


def test_a_first_click_off_the_object_is_explained(frame):
    session = Session()
    assert not session.click(frame, OFF, on_object=False)
    assert "Click on the object first" in session.error
    assert session.rule is None


def test_clicks_count_while_the_scene_looks_the_same(clicked, frame, wave, blue):
    noisy = np.clip(blue + np.random.default_rng(0).normal(0, 4, blue.shape), 0, 255).astype(np.uint8)
    assert len(clicked.clicks_in(Frame(noisy))[0]) == 1
    moved = Frame(np.roll(blue, 90, axis=0))
    assert clicked.clicks_in(moved) == ((), ())
    assert not clicked.click(moved, OFF, on_object=False)
    assert "moved" in clicked.error
    u, v = on(wave)
    assert clicked.click(moved, (u, v + 90))
    assert clicked.settings.picks == ((u, v + 90),)


def test_a_bad_value_keeps_the_detector_and_says_why(clicked):
    clicked.choose_rule("hsv")
    detector = clicked.detector
    assert not clicked.set(("segmentation", "low", 0), 400)
    assert "400" in clicked.error
    assert clicked.detector is detector
    assert clicked.set(("segmentation", "min_area"), 30)
    assert clicked.error == ""
    assert clicked.detector is not detector


def test_undo_and_redo(clicked):
    clicked.set(("shapes", 0, "n"), 12)
    clicked.choose_shape("contour")
    assert clicked.undo()
    assert (clicked.shape.kind, clicked.value(("shapes", 0, "n"))) == ("centerline", 12)
    assert clicked.undo()
    assert clicked.value(("shapes", 0, "n")) == 20
    assert clicked.undo()
    assert clicked.rule is None
    assert clicked.settings.picks == ()
    assert not clicked.undo()
    assert clicked.redo()
    assert clicked.rule is not None
    clicked.set(("shapes", 0, "n"), 7)
    assert not clicked.can_redo


def test_a_drag_of_a_slider_is_undone_at_once(clicked):
    for n in range(21, 40):
        clicked.set(("shapes", 0, "n"), n)
    assert clicked.undo()
    assert clicked.value(("shapes", 0, "n")) == 20


def test_shapes_of_each_kind_have_controls_within_their_range(clicked):
    for kind in ("centerline", "contour", "surface"):
        assert clicked.choose_shape(kind)
        for control in clicked.shape_controls():
            if control.type == "number":
                assert clicked.set(control.path, int(control.most) if control.whole else control.most), clicked.error
                assert clicked.set(control.path, int(control.least) if control.whole else control.least), clicked.error


@dataclass(frozen=True)
class Strict(Segmentation):
    """A rule of another package."""

    sharp: bool = True
    weights: tuple[float, float] = (1.0, 2.0)
    bias: int = -3

    def threshold(self, frame, window):
        """Return nothing."""
        return np.zeros((window.height, window.width), np.uint8)


def test_a_rule_has_sliders_for_numbers_pairs_and_both_bounds_of_a_channel_and_switches():
    found = {control.path: control for control in controls_of(Strict())}
    assert found["sharp",].type == "switch"
    assert [(found[path].least, found[path].most) for path in (("weights", 0), ("weights", 1), ("bias",))] == [
        (0, 4), (0, 8), (-12, 12)
    ]  # fmt: skip
    assert found["bias",].whole
    bounds = [control.path for control in controls_of(HSVRange((0, 1, 2), (3, 4, 5))) if len(control.path) == 2]
    assert bounds == [(bound, channel) for channel in range(3) for bound in ("low", "high")]


def test_what_is_saved_gives_the_same_points(clicked, blue, tmp_path):
    clicked.set(("shapes", 0, "n"), 15)
    clicked.save(tmp_path / "shape.yaml")
    again = ShapeDetector(**detector_arguments(load_config(tmp_path / "shape.yaml"))).detect(blue).shapes[0]
    np.testing.assert_array_equal(again.points2d, clicked.detector.detect(blue).shapes[0].points2d)
    assert len(again.points2d) == 15


def test_what_only_a_wrapper_reads_is_kept(tmp_path, clicked):
    save_config(tmp_path / "a.yaml", {**clicked.settings.arguments, "features": ["points2d"]})
    session = Session(load_config(tmp_path / "a.yaml"))
    session.set(("shapes", 0, "n"), 9)
    session.save(tmp_path / "b.yaml")
    session.save(tmp_path / "b.yaml")
    (tmp_path / "a.yaml").write_text("# edited by hand")
    with pytest.raises(FileExistsError, match="changed by another program"):
        session.save(tmp_path / "a.yaml")
    assert [each["kind"] for each in load_config(tmp_path / "b.yaml")["features"]] == ["points2d"]


def test_a_shape_with_a_rule_of_its_own_keeps_it_there(frame, wave):
    session = Session({"shapes": [{"kind": "centerline", "segmentation": {"kind": "gray", "high": 50}}]})
    assert session.rule_path == ("shapes", 0, "segmentation")
    assert session.click(frame, on(wave))
    assert session.shape.segmentation == session.rule
    assert session.config.segmentation is None


def test_nothing_can_be_saved_before_a_click(tmp_path):
    with pytest.raises(ValueError, match="click on the object first"):
        Session().save(tmp_path / "shape.yaml")


def test_read_only(clicked, frame, wave, tmp_path):
    session = Session(clicked.settings.arguments, read_only=True)
    for change in (
        lambda: session.click(frame, on(wave)),
        lambda: session.set(("shapes", 0, "n"), 5),
        lambda: session.set_roi(None),
        session.undo,
    ):
        assert not change()
        assert "read-only" in session.error
    with pytest.raises(PermissionError, match="read-only"):
        session.save(tmp_path / "shape.yaml")
    assert not list(tmp_path.iterdir())


def test_the_python_program_runs_and_finds_the_same(clicked, blue, tmp_path):
    cv2.imwrite(str(tmp_path / "rope.png"), cv2.cvtColor(blue, cv2.COLOR_RGB2BGR))
    clicked.set(("shapes", 0, "n"), 3)
    clicked.set_roi(((5.0, 5.0), (310.0, 230.0)))
    wanted = clicked.detector.detect(blue).shapes[0].points2d
    clicked.save(tmp_path / "shape.yaml")
    for kind, name in (("photo", "rope.png"), ("folder", ".")):
        program = clicked.python(name, kind, "shape.yaml")
        assert len(program.strip().splitlines()) <= 16
        done = subprocess.run(
            [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=120
        )
        assert done.returncode == 0, done.stderr
        assert done.stdout.startswith("True")
        found = np.array(done.stdout.replace("True", "").translate(str.maketrans("[]", "  ")).split(), float)
        np.testing.assert_allclose(found.reshape(3, 2), wanted, atol=1e-3)
