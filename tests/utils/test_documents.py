"""Any JSON or YAML file is read as plain values, or raises a declared error."""

from __future__ import annotations

import json

import pytest
from fuzzing.documents import damaged_documents, kinds
from hypothesis import given
from hypothesis import strategies as st

from shape_obs import Extrinsics, load_config
from shape_obs.ablation import load_study
from shape_obs.calibration.intrinsics import IntrinsicsFit
from shape_obs.calibration.touch_points import read_touches
from shape_obs.spec import SpecError
from shape_obs.utils.documents import parse_json, parse_yaml, read_json, read_yaml
from shape_obs.wrappers.target import Target

DEEP = "[" * 5000 + "]" * 5000
#: Each line doubles what the one before stands for: 2^40 values.
BOMB = "a0: &a0 [x, x]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 40))
plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=20,
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (DEEP, "nested too deep"),
        ("[" * 100 + "]" * 100, "nested too deeply; expected at most 64 levels"),
        ("[1, 2", "not valid JSON: "),
        (b"\xff\xfe", "not valid JSON: .*utf-8"),
        ("9" * 5000, "not valid JSON: "),
        ("", "not valid JSON: "),
        ('{"b": {"a": 1, "a": 2}}', "'a' is given twice"),
    ],
)
def test_json_that_cannot_be_read(text, message):
    with pytest.raises(SpecError, match=f"^here: .*{message}"):
        parse_json(text, "here")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (DEEP, "nested too deep"),
        ("- " * 100 + "x", "nested too deeply; expected at most 64 levels"),
        (BOMB, "holds more than 200000 values: write out the parts that its aliases repeat"),
        ("&a [*a]", "(nested too deep|aliases)"),
        ("!!timestamp 2020-13-45", "not valid YAML: month must be in 1..12"),
        ("!!int ''", "not valid YAML: IndexError"),
        ("!!python/object/apply:os.getpid []", "not valid YAML: could not determine a constructor"),
        ("{[1]: 2}", "not valid YAML: "),
        (b"a: \xff", "not valid YAML: .*utf-8"),
        ("#" * (9 << 20), "expected at most 8388608 bytes of YAML"),
        ("a: 1\nb: 2\na: 3", "'a' is given twice.*line 3"),
        ("{x: {y: 1, 'y': 2}}", "'y' is given twice"),
        ("{a:1}", "space after its colon"),
        ("a:\n\t- 1", "spaces, not with tabs"),
    ],
    ids=range(14),
)
def test_yaml_that_cannot_be_read(text, message):
    with pytest.raises(SpecError, match=f"(?s)^here: .*{message}"):
        parse_yaml(text, "here")


def test_what_is_right_comes_back(tmp_path):
    """A file may use an anchor twice, and begin with a byte order mark, as editors of Windows write it."""
    assert parse_yaml("a: &x [1, 2]\nb: *x\n", "here") == {"a": [1, 2], "b": [1, 2]}
    (tmp_path / "x.json").write_bytes(b'\xef\xbb\xbf{"a": 1}')
    assert read_json(tmp_path / "x.json", "x") == {"a": 1}
    with pytest.raises(FileNotFoundError, match=r"y\.json: no such x file"):
        read_json(tmp_path / "y.json", "x")
    with pytest.raises(SpecError, match="expected a x file, got a folder"):
        read_yaml(tmp_path, "x")


@given(plain)
def test_every_value_survives_json(value):
    assert parse_json(json.dumps(value).encode(), "here") == value


@pytest.mark.parametrize(
    ("read", "name", "text"),
    [
        (load_config, "c.yaml", "version: 1\nshape: " + DEEP),
        (Target.load, "g.yaml", "version: 1\ngoal: &a {points: *a}"),
        (load_study, "s.yaml", "- " * 5000),
        (Extrinsics.load, "e.json", DEEP),
        (IntrinsicsFit.load, "i.json", '{"a":' * 100 + "0" + "}" * 100),
        (read_touches, "t.json", DEEP),
    ],
)
def test_every_reader_names_its_file(tmp_path, read, name, text):
    (tmp_path / name).write_text(text)
    with pytest.raises(SpecError, match=name):
        read(tmp_path / name)


@pytest.mark.parametrize("count", [20, pytest.param(500, marks=pytest.mark.nightly)])
def test_damaged_documents_raise_only_declared_errors(tmp_path, count):
    for kind in kinds():
        found = damaged_documents(kind, tmp_path, count, seed=1)
        assert found["undeclared"] == 0, kind.name
        assert found["refused"] >= 0.1 * count, kind.name
