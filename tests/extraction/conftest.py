"""The command `shape-obs extract`, run in this process."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest


@pytest.fixture
def extract(run: Callable[..., tuple[int, str, str]]) -> Callable[..., tuple[int, Any, str]]:
    """Return a function that runs ``shape-obs extract ARGUMENTS --json``.

    It returns the exit code, what was printed as JSON, None for nothing, and stderr.
    """

    def extract(*arguments: object) -> tuple[int, Any, str]:
        code, out, err = run("extract", *arguments, "--json")
        return code, json.loads(out) if out else None, err

    return extract
