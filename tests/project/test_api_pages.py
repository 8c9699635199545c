"""The pages of the Python API list every public name, and every public function has types."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
from collections.abc import Callable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import pytest

PAGES = Path(__file__).parents[2] / "docs" / "reference" / "api"
ENTRY = re.compile(r"^\.\. auto(?:class|function|exception|data|module):: (\S+)", re.MULTILINE)
LISTED = [entry for page in sorted(PAGES.glob("*.md")) for entry in ENTRY.findall(page.read_text(encoding="utf-8"))]


def resolve(path: str) -> Any:
    parts = path.split(".")
    for end in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:end]))
        except ModuleNotFoundError:
            continue
        for name in parts[end:]:
            found = getattr(found, name)
        return found
    raise ModuleNotFoundError(path)


def packages() -> Iterator[Any]:
    for root in map(importlib.import_module, ("shape_obs", "shape_obs_envs")):
        yield root
        for module in pkgutil.walk_packages(root.__path__, f"{root.__name__}."):
            if module.ispkg and not module.name.startswith("shape_obs.tuner"):
                yield importlib.import_module(module.name)


def untyped(function: Callable[..., Any], path: str) -> list[str]:
    signature = inspect.signature(function)
    missing = [
        f"{path}({name})"
        for name, parameter in signature.parameters.items()
        if parameter.annotation is inspect.Parameter.empty and name not in ("self", "cls")
    ]
    returns = signature.return_annotation is inspect.Signature.empty and not path.endswith("__init__")
    return missing + [f"{path} -> ?"] * returns


def own_methods(cls: type) -> Iterator[tuple[str, Callable[..., Any]]]:
    for name, member in vars(cls).items():
        member = getattr(member, "__func__", member)
        if inspect.isfunction(member) and member.__module__.startswith("shape_obs"):
            if name == "__init__" or not name.startswith("_"):
                yield name, member
        elif isinstance(member, property) and not name.startswith("_") and member.fget is not None:
            yield name, member.fget


def documented_attributes(cls: type) -> list[str]:
    _, _, section = (inspect.getdoc(cls) or "").partition("\nAttributes:\n")
    return re.findall(r"^ {4}(\w+): ", re.split(r"^\S", section, maxsplit=1, flags=re.MULTILINE)[0], re.MULTILINE)


def has_type(cls: type, name: str) -> bool:
    if any(name in inspect.get_annotations(base) for base in cls.__mro__ if base.__module__.startswith("shape_obs")):
        return True
    member = inspect.getattr_static(cls, name, None)
    getter = member.func if isinstance(member, cached_property) else getattr(member, "fget", None)
    return getter is not None and "return" in getter.__annotations__


def test_every_public_name_is_listed():
    pytest.importorskip("mujoco")
    pytest.importorskip("torch")
    pytest.importorskip("pyarrow")
    listed = [resolve(entry) for entry in LISTED]
    for package in packages():
        for name in getattr(package, "__all__", ()):
            public = getattr(package, name)
            assert any(public is entry for entry in listed), f"{package.__name__}.{name} is on no page of the API"


def test_no_name_is_listed_twice():
    assert len(LISTED) == len(set(LISTED))


@pytest.mark.parametrize("path", LISTED)
def test_every_listed_function_has_types(path):
    pytest.importorskip("mujoco")
    pytest.importorskip("torch")
    pytest.importorskip("pyarrow")
    public = resolve(path)
    missing = []
    if inspect.isclass(public):
        for name, method in own_methods(public):
            missing += untyped(method, f"{path}.{name}")
    elif inspect.isfunction(public):
        missing = untyped(public, path)
    assert not missing


def test_every_documented_attribute_has_a_type():
    pytest.importorskip("mujoco")
    pytest.importorskip("torch")
    pytest.importorskip("pyarrow")
    classes = {path: public for path in LISTED if inspect.isclass(public := resolve(path))}
    documented = [(path, name) for path, public in classes.items() for name in documented_attributes(public)]
    assert ("shape_obs.ShapeObservation", "detector") in documented
    assert [f"{path}.{name}" for path, name in documented if not has_type(classes[path], name)] == []
