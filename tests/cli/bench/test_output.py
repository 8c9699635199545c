"""Options, tables, JSON and help that all measurements share."""

from __future__ import annotations

import json

import pytest

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
