"""YAML in files and on the command line is read as its users mean it."""

from __future__ import annotations

import math
from typing import Any

import pytest
import yaml

from shape_obs import load_config
from shape_obs.spec import SpecError
from shape_obs.utils.documents import dump_yaml, parse_yaml


@pytest.mark.parametrize(
    ("text", "value"),
    [
        *[(text, text) for text in ("034422070605", "020", "1:30", "1_000", "0b11", "2026-11-27", "=", "12e34567")],
        *[("8e-3", 0.008), ("1e2", 100.0), ("-.5E+3", -500.0), ("00.5", 0.5), ("-.inf", -math.inf), ("5.", 5.0)],
        *[("+5", 5), ("0x1F", 31), ("yes", True), ("off", False), ("~", None), ("'1e2'", "1e2"), ("1.2.3", "1.2.3")],
        ("{on: 1, no: [1e1]}", {"on": 1, "no": [10.0]}),
        ("b: &x {q: 1, r: 1}\nc:\n  <<: *x\n  q: 2\nd:\n  <<: *x", {"b": {"q": 1, "r": 1}, "c": {"q": 2, "r": 1},
         "d": {"q": 1, "r": 1}}),
    ],
)  # fmt: skip
def test_values_are_what_people_mean_and_are_written_so_that_every_reader_agrees(text, value):
    assert parse_yaml(text, "here") == value
    written = dump_yaml({"v": value})
    assert parse_yaml(written, "here") == yaml.safe_load(written) == {"v": value}


def test_a_number_with_leading_zeros_is_no_octal_number_of_points(tmp_path):
    (tmp_path / "shape.yaml").write_text("version: 1\nshape: {shapes: [{kind: centerline, n: 020}], features: [ok]}")
    with pytest.raises(SpecError, match=r"n: expected int, got '020'"):
        load_config(tmp_path / "shape.yaml")


class Settings:
    """Keep what a command gives."""

    def __init__(self, **given: Any) -> None:
        raise ValueError(f"given: {given}")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            ["serial=034422", "exposure=8e-3", "offset=1:30"],
            "'034422', 'exposure': 0.008, 'offset': '1:30'",
        ),
        (["serial=null", "depth=no", "name='#1'"], "'serial': None, 'depth': False, 'name': '#1'"),
        (["a=1", "a=2"], "a is given twice, as 1 and '2'"),
        (["serial="], "write serial=null"),
        (["colour=#ff0000"], "write colour=null"),
        (["name=rope #1"], "YAML reads 'rope'; put the text in quotes"),
    ],
)
def test_settings_of_a_command(run, monkeypatch, settings, message):
    monkeypatch.setattr("fake_camera.Settings", Settings, raising=False)
    code, _, err = run("record", "--source", "fake_camera:Settings", "-o", "none", "--set", *settings)
    assert (code, err.count("\n")) == (2, 1)
    assert message in err
