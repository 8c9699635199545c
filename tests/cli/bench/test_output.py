"""Options, tables, JSON and help that all measurements share."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from tests.benchmarks.cli import MEASUREMENTS
from tests.benchmarks.cli.output import Output, image_size


def test_tables_are_printed_when_they_are_complete(capsys):
    output = Output(False, measurement="it")
    output.table("title", [{"a": 1}])
    output.close()
    assert capsys.readouterr().out == "\ntitle\na\n1\n"


def test_json_is_one_document_at_the_end(capsys):
    output = Output(True, measurement="it")
    output.note("not printed")
    output.table("title", [{"a": 1}], "key")
    output.table("not in the document", [{"a": 1}], "")
    output.claims([])
    assert capsys.readouterr().out == ""
    output.close()
    assert json.loads(capsys.readouterr().out) == {"measurement": "it", "key": [{"a": 1}], "claims": []}


@pytest.mark.parametrize("text", ["640", "640x", "axb", "16x640", "8x8", "9999x9999"])
def test_a_size_has_two_numbers_in_range(text):
    assert image_size("640x480", 16) == (640, 480)
    with pytest.raises(ValueError, match=r"--sizes: expected WIDTHxHEIGHT of at least 16 pixels .*, got '"):
        image_size(text, 16)


@pytest.mark.parametrize("name", MEASUREMENTS)
def test_help_imports_no_measurement(name):
    code = (
        "import sys\nfrom shape_obs.cli import main\n"
        f"try: main(['bench', '{name}', '--help'])\n"
        "except SystemExit as stop: assert not stop.code\n"
        "heavy = {'numpy', 'cv2', 'scipy', 'numba', 'gymnasium', 'mujoco'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr
    assert f"shape-obs bench {name}" in done.stdout
