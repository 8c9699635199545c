"""Words for cameras and classes: which source each opens, and what a class must have."""

from __future__ import annotations

import sys
from textwrap import dedent

import numpy as np
import pytest

from shape_obs.cli import main
from shape_obs.source import BadRecording, RGBDSource
from shape_obs_envs.sources import open_source

CAMERA = """
    import time

    import numpy as np

    from shape_obs.frame import Frame
    from shape_obs.source import EndOfSource, Source


    class Counter(Source):
        kind, name, live, has_depth, intrinsics = "counter", "counter", False, False, None

        def __init__(self, first=0, frames=5, extrinsics=None, width=30):
            super().__init__(extrinsics)
            self.first, self.frames, self.width = first, frames, width

        def connect(self):
            self.number = 0

        def disconnect(self):
            pass

        def read(self, timeout=1.0, fresh=False):
            if self.number == self.frames:
                raise EndOfSource("counted")
            value, self.number = self.first + self.number, self.number + 1
            rgb = np.full((20, self.width, 3), value, np.uint8)
            return Frame(rgb, stamp=value / 10, received=time.monotonic(), number=self.number - 1)

        def read_latest(self, max_age=0.1):
            return self.read()


    class Half:
        kind, name, live = "half", "half", True

        def connect(self):
            pass

        def read(self, timeout=1.0, fresh=False):
            raise AssertionError("the check must not read")


    class Deaf(Counter):
        def read(self, seconds=1.0):
            return super().read(seconds)


    class Wrong(Counter):
        def read(self, timeout=1.0, fresh=False):
            return super().read().rgb


    def fast(**arguments):
        return Counter(frames=2, **arguments)


    number = 3
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Write a module with cameras, and return its name."""
    (tmp_path / "their_camera.py").write_text(dedent(CAMERA))
    monkeypatch.syspath_prepend(str(tmp_path))
    yield "their_camera"
    sys.modules.pop("their_camera", None)


def test_a_class_is_opened_with_its_arguments(module):
    source = open_source(f"{module}:Counter", first=7, width=16)
    with source:
        assert isinstance(source, RGBDSource)
        assert (source.kind, source.intrinsics, source.camera) == ("counter", None, None)
        frame = source.read()
    assert frame.rgb is not None
    assert frame.rgb.shape == (20, 16, 3)
    assert frame.rgb[0, 0, 0] == 7
    with open_source(f"{module}:fast") as source:  # a function that makes one
        assert sum(1 for _ in iter(lambda: source.read().number, 1)) == 1


@pytest.mark.parametrize(
    ("name", "arguments", "error", "message"),
    [
        (
            "Half",
            {},
            TypeError,
            r"source their_camera:Half: expected .*RGBDSource .*, Half has no has_depth, intrinsics, camera, "
            r"read_latest\(\), disconnect\(\), __enter__\(\), __exit__\(\)\. Subclass .*LiveSource",
        ),
        ("Deaf", {}, TypeError, r"Deaf\.read must take the arguments timeout, fresh"),
        ("number", {}, ValueError, "their_camera:number is a int, expected a class or a function"),
        ("Counter", {"speed": 3}, ValueError, "their_camera:Counter does not take {'speed': 3}"),
        ("Countr", {}, ValueError, "has no 'Countr'; did you mean 'Counter'"),
    ],
)
def test_a_class_that_is_no_source_says_what_is_missing(name, arguments, error, message, module):
    with pytest.raises(error, match=message) as caught:
        open_source(f"{module}:{name}", **arguments)
    assert "\n" not in str(caught.value)


def test_a_module_in_this_folder_that_python_does_not_find_says_so(tmp_path, monkeypatch):
    (tmp_path / "lost_camera.py").write_text("class Camera: pass")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry not in ("", str(tmp_path))])
    with pytest.raises(
        ImportError, match=r"cannot import 'lost_camera'.*lost_camera\.py is in this folder.*PYTHONPATH"
    ):
        open_source("lost_camera:Camera")
    with pytest.raises(ImportError, match="cannot import 'no_such_camera': No module named") as caught:
        open_source("no_such_camera:Camera")
    assert "PYTHONPATH" not in str(caught.value)


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as stop:
        main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return stop.value.code, captured.out, captured.err


def test_a_class_is_recorded(module, capsys, tmp_path):
    word = f"{module}:Counter"
    code, _, err = run(capsys, "record", "--source", word, "--set", "first=50", "frames=4", "-o", tmp_path / "four")
    assert code == 0, err
    with open_source(tmp_path / "four") as source:
        frames = [source.read() for _ in range(4)]
    assert [int(np.asarray(frame.rgb)[0, 0, 0]) for frame in frames] == [50, 51, 52, 53]
    assert [frame.stamp for frame in frames] == pytest.approx([5.0, 5.1, 5.2, 5.3])
    code, _, err = run(capsys, "record", "--source", f"{module}:Half", "-o", tmp_path / "half")
    assert (code, "Half has no has_depth" in err) == (1, True)
    code, _, err = run(capsys, "record", "--source", f"{module}:Wrong", "-o", tmp_path / "wrong")
    assert (code, "counter: read() returned a ndarray, expected a shape_obs.Frame" in err) == (1, True)
    with pytest.raises(BadRecording):
        open_source("none.mcap")
