"""JSON and YAML members of a bundle, bounded in size, depth and numbers."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, Final

import yaml

from shape_obs.deploy.policy_bundle.errors import BundleError

MOST_DEPTH: Final = 16
MOST_VALUES: Final = 100_000
MOST_TEXT: Final = 65_536
#: Whole numbers beyond this are not exact in JSON.
MOST_NUMBER: Final = 2**53


def write_json(value: Mapping[str, Any]) -> bytes:
    """Write a JSON member: one line for each entry of its own, since bounds of a space are long lists."""
    lines = ",\n".join(f"  {json.dumps(name)}: {json.dumps(item)}" for name, item in value.items())
    return f"{{\n{lines}\n}}\n".encode()


def read_json(data: bytes, what: str) -> dict[str, Any]:
    """Read a JSON member, an object.

    Args:
        data: Its bytes; the archive has bounded how many.
        what: The member, for messages.

    Raises:
        BundleError: It is no JSON object, nested too deep, or holds too much.
    """
    try:
        value = json.loads(data, object_pairs_hook=_unique)
    except (ValueError, RecursionError) as error:
        raise BundleError(f"{what} cannot be read: {error}") from error
    return _checked(value, what)


def write_yaml(value: Any) -> bytes:
    """Write a YAML member without aliases."""
    return yaml.dump(value, Dumper=_Plain, sort_keys=False).encode()


def read_yaml(data: bytes, what: str) -> dict[str, Any]:
    """Read a YAML member, a mapping; errors as those of ``read_json``, and aliases and tags are refused."""
    try:
        value = yaml.load(data, Loader=_Bounded)
    except (yaml.YAMLError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise BundleError(f"{what} cannot be read: {error}") from error
    return _checked(value, what)


class _Plain(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:
        return True


class _Bounded(yaml.SafeLoader):
    """PyYAML's safe loader, which stops at the first alias and at the depth that is allowed."""

    _depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("it has an alias (*name), which bundles do not use")
        if self._depth > MOST_DEPTH:
            raise yaml.YAMLError(f"it is nested deeper than {MOST_DEPTH}")
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        raise ValueError("a name stands twice in one object")
    return values


def _checked(value: Any, what: str) -> dict[str, Any]:
    """Return a document that is a mapping of plain values within the bounds."""
    if not isinstance(value, dict):
        raise BundleError(f"{what}: expected an object, got {type(value).__name__}.")
    count = 0
    level: list[Any] = [value]
    for _ in range(MOST_DEPTH):
        count += len(level)
        if count > MOST_VALUES:
            raise BundleError(f"{what}: expected at most {MOST_VALUES} values, got more.")
        for item in level:
            _check_plain(item, what)
        level = [inner for item in level for inner in _inside(item)]
        if not level:
            return value
    raise BundleError(f"{what}: it is nested deeper than {MOST_DEPTH}.")


def _inside(value: Any) -> list[Any]:
    if isinstance(value, Mapping):
        return list(value.values())
    return value if isinstance(value, list) else []


def _check_plain(value: Any, what: str) -> None:
    if isinstance(value, dict):
        wrong = next((key for key in value if not isinstance(key, str) or len(key) > MOST_TEXT), None)
        if wrong is not None:
            raise BundleError(f"{what}: expected short text as a name, got {str(wrong)[:80]!r}.")
    elif isinstance(value, str):
        if len(value) > MOST_TEXT:
            raise BundleError(f"{what}: expected text of at most {MOST_TEXT} characters, got {len(value)}.")
    elif isinstance(value, int):
        if abs(value) > MOST_NUMBER:
            raise BundleError(f"{what}: expected whole numbers up to 2**53, got one of {value.bit_length()} bits.")
    elif not (value is None or isinstance(value, (float, list))):
        raise BundleError(f"{what}: expected plain values, got {type(value).__name__}.")


def is_number(value: Any) -> bool:
    """Whether a value is a finite number and no bool."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
