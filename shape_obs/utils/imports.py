"""Classes and functions by their names: ``module:Name``."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any

from shape_obs.spec import did_you_mean


def load_named(text: str, what: str) -> Any:
    """What ``module:Name`` names.

    Args:
        text: Such as ``"my_lab.arm:Arm"``; the module is looked for as ``import`` does.
        what: What it is for, for messages: ``"--robot"``.

    Raises:
        ValueError: Not of this form, or the module has no such name.
        ImportError: There is no such module, or importing it fails.
    """
    module_name, _, name = text.partition(":")
    if not module_name or not name:
        raise ValueError(f"{what}: expected module:Name, such as my_lab.arm:Arm, got {text!r}.")
    try:
        module = import_module(module_name)
    except ImportError as error:
        raise ImportError(f"{what}: cannot import {module_name!r}: {error}") from error
    try:
        return getattr(module, name)
    except AttributeError:
        names = [known for known in dir(module) if not known.startswith("_")]
        raise ValueError(f"{what}: module {module_name!r} has no {name!r}{did_you_mean(name, names)}") from None


def make_named(text: str, what: str, arguments: Mapping[str, Any] | None = None) -> Any:
    """Call what ``module:Name`` names with keyword arguments.

    Raises:
        ValueError: It cannot be called so.
    """
    maker = load_named(text, what)
    if not callable(maker):
        raise ValueError(f"{what}: {text} is a {type(maker).__name__}, expected a class or a function.")
    try:
        return maker(**(arguments or {}))
    except TypeError as error:
        raise ValueError(f"{what}: {text} does not take {dict(arguments or {})}: {error}") from error
