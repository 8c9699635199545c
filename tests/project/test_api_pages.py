"""The pages of the Python API list every public name once."""

from __future__ import annotations

import importlib
import pkgutil
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

PAGES = Path(__file__).parents[2] / "docs" / "reference" / "api"
ENTRY = re.compile(r"^\.\. auto(?:class|function|exception|data|module):: (\S+)", re.MULTILINE)


def resolve(path: str) -> Any:
    module, _, name = path.rpartition(".")
    try:
        return importlib.import_module(path)
    except ModuleNotFoundError:
        return getattr(resolve(module), name)


def packages() -> Iterator[Any]:
    for root in map(importlib.import_module, ("shape_obs", "shape_obs_envs")):
        yield root
        for module in pkgutil.walk_packages(root.__path__, f"{root.__name__}."):
            if module.ispkg and not module.name.startswith("shape_obs.tuner"):
                yield importlib.import_module(module.name)


def test_every_public_name_is_listed_once():
    for name in ("mujoco", "torch", "pyarrow"):
        pytest.importorskip(name)
    entries = [
        entry for page in sorted(PAGES.glob("*.md")) for entry in ENTRY.findall(page.read_text(encoding="utf-8"))
    ]
    assert len(entries) == len(set(entries))
    listed = [resolve(entry) for entry in entries]
    for package in packages():
        for name in getattr(package, "__all__", ()):
            public = getattr(package, name)
            assert any(public is entry for entry in listed), f"{package.__name__}.{name} is on no page of the API"
