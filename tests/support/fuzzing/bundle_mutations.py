"""Bundles with random damage: of the file, and within its members with checksums that fit again."""

from __future__ import annotations

import copy
import json
import struct
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml

from fuzzing.bundle_sample import Members, edited, pack
from shape_obs.config.config_file import SECTIONS, schema_hash
from shape_obs.deploy.policy_bundle.archive import CONFIG, ENV, RECORD, STATISTICS, WEIGHTS, extract, unpack
from shape_obs.deploy.policy_bundle.documents import MALFORMED

_HOSTILE: Final = (
    None, True, False, 0, -1, 1, 2**31, 2**63, -(2**63), 10**9, 1e308, -1e308, 1e-308, float("nan"), float("inf"),
    "", "x", "bundle_canary:Class", "/dev/zero", "../..", "\0", "x" * 10_000, [], {}, [[]], [None], {"kind": "canary"},
    {"kind": "pca", "file": "/dev/zero"}, [0] * 1000, [1e308] * 3, {"": ""}, [[0.0] * 100] * 100,
)  # fmt: skip


def mutations(sample: Members, count: int, seed: int) -> Iterator[tuple[str, bytes]]:
    """Draw damaged files: (name, content)."""
    rng = np.random.default_rng(seed)
    plain = pack(sample)
    for number in range(count):
        kind = _KINDS[number % len(_KINDS)]
        yield f"{number}: {kind.__name__.strip('_')}", kind(sample, plain, rng)


def _flipped(sample: Members, plain: bytes, rng: np.random.Generator) -> bytes:
    data = bytearray(plain)
    for at in rng.integers(len(data), size=int(rng.integers(1, 20))):
        data[at] ^= 1 << int(rng.integers(8))
    return bytes(data)


def _directory_flipped(sample: Members, plain: bytes, rng: np.random.Generator) -> bytes:
    data, start = bytearray(plain), plain.index(b"PK\x01\x02")
    for at in rng.integers(start, len(data), size=int(rng.integers(1, 6))):
        data[at] = int(rng.integers(256))
    return bytes(data)


def _truncated(sample: Members, plain: bytes, rng: np.random.Generator) -> bytes:
    start, end = sorted(int(at) for at in rng.integers(len(plain), size=2))
    return (plain[:end], plain[start:], plain[:start] + plain[end:], plain + plain[start:end])[int(rng.integers(4))]


def _swapped(sample: Members, plain: bytes, rng: np.random.Generator) -> bytes:
    members, names = dict(sample), list(sample)
    one, other = rng.choice(len(names), 2, replace=False)
    if rng.random() < 0.7:
        members[names[one]], members[names[other]] = members[names[other]], members[names[one]]
    else:
        del members[names[one]]
    return pack(members)


def _member_flipped(sample: Members, plain: bytes, rng: np.random.Generator) -> bytes:
    """Flip bits within a member, with the checksum of the result."""
    name = list(sample)[int(rng.integers(len(sample)))]
    data = bytearray(sample[name])
    for at in rng.integers(len(data), size=int(rng.integers(1, 8))):
        data[at] ^= 1 << int(rng.integers(8))
    return pack({**sample, name: bytes(data)})


def _json_changed(sample: Members, plain: bytes, rng: np.random.Generator) -> bytes:
    name = (RECORD, ENV)[int(rng.integers(2))]
    document = json.loads(sample[name])
    for _ in range(int(rng.integers(1, 4))):
        _change(document, rng)
    return pack({**sample, name: json.dumps(document).encode()})


def _network_changed(sample: Members, plain: bytes, rng: np.random.Generator) -> bytes:
    network = json.loads(sample[RECORD])["network"]
    _change(network["arguments"] if rng.random() < 0.5 else network, rng)
    return pack(edited(sample, RECORD, network=network))


def _yaml_changed(sample: Members, plain: bytes, rng: np.random.Generator) -> bytes:
    text = sample[CONFIG].decode()
    if rng.random() < 0.3:
        lines = text.splitlines()
        added = ("&a [*a]", "!!python/name:os.system", "*unknown", "!!binary x", "{{}: 1}", "\t", "? [", "<<: 1")
        at = int(rng.integers(len(lines)))
        lines[at] = f"{lines[at].partition(':')[0]}: {added[int(rng.integers(len(added)))]}"
        return pack({**sample, CONFIG: "\n".join(lines).encode()})
    document = yaml.safe_load(text)
    _change(document, rng)
    changed = {**sample, CONFIG: yaml.safe_dump(document).encode("utf-8", "replace")}
    return pack(edited(changed, RECORD, schema=_schema(sample, document)))


def _schema(sample: Members, document: Any) -> str | None:
    """Return the hash of a configuration's schema, if it has one, as a careful attacker would write it."""
    fitted = {name: data for name, data in sample.items() if name.startswith("files/")}
    with tempfile.TemporaryDirectory() as folder:
        extract(fitted, Path(folder))
        try:
            sections = unpack(document, fitted, Path(folder), trust=False)
            return schema_hash({key: value for part in SECTIONS for key, value in sections.get(part, {}).items()})
        except MALFORMED:
            return None


def _tensors_changed(sample: Members, plain: bytes, rng: np.random.Generator) -> bytes:
    name = (WEIGHTS, STATISTICS)[int(rng.integers(2))]
    data = sample[name]
    length = int.from_bytes(data[:8], "little")
    header, body = json.loads(data[8 : 8 + length]), data[8 + length :]
    way = rng.random()
    if way < 0.7:
        _change(header, rng)
    elif way < 0.85:
        body = body[: int(rng.integers(len(body)))]
    else:
        body = rng.bytes(len(body))
    text = json.dumps(header).encode()
    return pack({**sample, name: struct.pack("<Q", len(text)) + text + body})


_KINDS: Final = (
    _flipped, _json_changed, _truncated, _network_changed, _swapped, _json_changed, _member_flipped, _yaml_changed,
    _directory_flipped, _tensors_changed,
)  # fmt: skip


def _change(document: Any, rng: np.random.Generator) -> None:
    """Change one place of a document: replace, remove, add, scale or nest a value, or rename it."""
    holders = [holder for holder in _holders(document) if holder]
    holder = holders[int(rng.integers(len(holders)))] if holders else document
    keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
    key = keys[int(rng.integers(len(keys)))]
    value, way = holder[key], int(rng.integers(6))
    if way == 0:
        del holder[key]
    elif way == 1 and isinstance(holder, dict):
        holder["unknown"] = _hostile(rng)
    elif way == 2:
        for _ in range(int(rng.choice([1, 20, 100]))):
            value = [value]
        holder[key] = value
    elif way == 3 and isinstance(value, (int, float)):
        holder[key] = value * float(rng.choice([-1, 0.5, 2, 1e6, 1e30])) if rng.random() < 0.5 else str(value)
    elif way == 4 and isinstance(holder, dict):
        holder[f"{key}x"] = holder.pop(key)
    else:
        holder[key] = _hostile(rng)


def _hostile(rng: np.random.Generator) -> Any:
    return copy.deepcopy(_HOSTILE[int(rng.integers(len(_HOSTILE)))])


def _holders(value: Any) -> Iterator[Any]:
    """Yield the objects and lists of a document, and only the first few of many numbers."""
    if isinstance(value, (dict, list)):
        yield value
        for inner in value.values() if isinstance(value, dict) else value[:4]:
            yield from _holders(inner)
