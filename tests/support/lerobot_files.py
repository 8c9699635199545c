"""Run `shape-obs extract --to lerobot`, and read the files that it writes."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from pyarrow import parquet

from shape_obs.cli import main


def run(capsys: Any, *arguments: Any) -> tuple[Any, Any, str]:
    """Return (exit code, parsed output of --json or None, stderr) of `shape-obs extract`, run in this process."""
    with pytest.raises(SystemExit) as stop:
        main(["extract", *map(str, arguments), "--json"])
    captured = capsys.readouterr()
    return stop.value.code, json.loads(captured.out) if captured.out else None, captured.err


def read(made, name):
    return json.loads((made / "meta" / f"{name}.json").read_text())


def rows(made):
    return parquet.read_table(made / "data" / "chunk-000" / "file-000.parquet")


def array(table, name):
    return np.asarray(table[name].to_pylist())
