"""Crafted bundles whose archive, documents or tensors try to take memory or time, or to write outside."""

from __future__ import annotations

import io
import json
import stat
import struct
import zipfile
import zlib
from collections.abc import Iterator
from typing import Final

import numpy as np

from fuzzing.bundle_sample import Members, edited, pack, pack_plain
from shape_obs.deploy.policy_bundle.archive import CONFIG, ENV, RECORD, STATISTICS, WEIGHTS

Crafted = Iterator[tuple[str, bytes]]
_BOMB: Final = 256 * 2**20
_HUGE: Final = 10**9
_DATE: Final = (1980, 1, 1, 0, 0, 0)


def bombs(sample: Members) -> Crafted:
    """Yield small files that demand many resources: (name, content)."""
    for group in (_archives, _names, _documents, _tensors):
        yield from group(sample)


def _archives(sample: Members) -> Crafted:
    zeros = bytes(_BOMB)
    plain, packed = pack(sample), pack({**sample, RECORD: zeros})
    yield "flat zip bomb", packed
    yield "zip bomb in the manifest", pack_plain({"manifest.json": zeros})
    yield "lying size", packed.replace(struct.pack("<L", _BOMB), struct.pack("<L", 1000))
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("manifest.json", b"{}")
        archive.writestr(WEIGHTS, zeros)
    yield "compressed weights", buffer.getvalue()
    start = plain.index(b"PK\x01\x02")
    first = plain[start : plain.index(b"PK\x01\x02", start + 4)]
    entries, end = plain[start:-22], plain[-22:]
    yield "overlapping members", plain[:start] + _directory(first + entries, len(sample) + 2, start)
    yield "many entries of one member", plain[:start] + _directory(first * 60_000, 60_000, start)
    locator = struct.pack("<4sLQL", b"PK\x06\x07", 0, start, 1)
    record = struct.pack("<4sQ2H2L4Q", b"PK\x06\x06", 44, 45, 45, 0, 0, 2**40, 2**40, 2**50, start)
    yield "zip64 that lies", plain[:start] + entries + record + locator + end
    yield "program before the zip", b"#!/bin/sh\ntouch $BUNDLE_CANARY\n" + plain
    yield "comment after the zip", plain[:-2] + struct.pack("<H", 5) + b"hello"
    yield "encrypted", _flagged(plain, 6, 1)
    yield "unknown compression", _flagged(plain, 8, 99)
    for method in (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w", method) as archive:
            archive.writestr("manifest.json", bytes(10**6))
        yield f"compression {method}", buffer.getvalue()
    yield "zip of a zip", pack({**sample, RECORD: pack(sample)})
    yield "damaged deflate", plain.replace(_deflated(sample[ENV])[:20], b"\x04\xc0\x81" * 6 + b"\0\0")


def _names(sample: Members) -> Crafted:
    for name in (
        "../escaped", "/tmp/escaped", "files/../../escaped", "files\\..\\escaped", "C:escaped", "files/", "files/a.npz",
        "files/0123456789abcdef.npz/x", "files/0123456789abcdef.npz\0.policy", "~/escaped", "", "\u202eescaped",
    ):  # fmt: skip
        yield f"member {name!r}", pack({**sample, name: b"escaped"})
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, data in _with_manifest(sample).items():
            info = zipfile.ZipInfo(name, _DATE)
            info.external_attr = (stat.S_IFLNK | 0o777) << 16 if name == WEIGHTS else 0o600 << 16
            archive.writestr(info, b"/etc/passwd" if name == WEIGHTS else data)
    yield "symbolic link", buffer.getvalue()
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, data in [*_with_manifest(sample).items(), ("policy.jsoM", b"{}")]:
            archive.writestr(zipfile.ZipInfo(name, _DATE), data)
    yield "a name twice", buffer.getvalue().replace(b"policy.jsoM", RECORD.encode())
    yield "many fitted files", pack({**sample, **{f"files/{i:016x}.npz": b"x" for i in range(100)}})


def _documents(sample: Members) -> Crafted:
    deep = b'{"a":' * 30_000 + b"1" + b"}" * 30_000
    lists = b'{"a":' + b"[" * 100_000 + b"]" * 100_000 + b"}"
    for name, data in (
        ("deep objects", deep),
        ("deep lists", lists),
        ("a long number", b'{"a":' + b"9" * 200_000 + b"}"),
    ):
        for member in (RECORD, ENV):
            yield f"{name} in {member}", pack({**sample, member: data})
        yield f"{name} in the manifest", pack_plain({**sample, "manifest.json": data[:60_000]})
    yield "wide JSON", pack({**sample, RECORD: b'{"summary": [' + b"0," * 900_000 + b"0]}"})
    yield "JSON in UTF-32", pack({**sample, ENV: sample[ENV].decode().encode("utf-32")})
    for what in ([], None, 1, "text", [{}]):
        yield f"env.json is {what!r}", pack({**sample, ENV: json.dumps(what).encode()})
        yield f"manifest lists {what!r}", pack(sample, members=what)
        yield f"version {what!r}", pack(sample, version=what)
    yield "version true", pack(sample, version=True)
    yield "version 1e999", pack(sample, version=float("inf"))
    yield "checksums of nothing", pack(sample, members=dict.fromkeys(sample))
    aliases = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
        f"{new}: &{new} [{', '.join([f'*{old}'] * 9)}]\n" for old, new in zip("abcdefgh", "bcdefghi", strict=True)
    )
    yield "YAML aliases", pack({**sample, CONFIG: aliases.encode()})
    yield "YAML alias of itself", pack({**sample, CONFIG: b"shape: &a {shapes: *a}"})
    yield "deep YAML", pack({**sample, CONFIG: b"[" * 30_000})
    yield "deep YAML mappings", pack({**sample, CONFIG: b"{a: " * 8000})
    yield "wide YAML", pack({**sample, CONFIG: b"shape: [" + b"a," * 16_000 + b"]"})
    yield "YAML number", pack({**sample, CONFIG: b"shape: " + b"9" * 32_000})
    yield "YAML of sixties", pack({**sample, CONFIG: b"shape: 1" + b":59" * 10_000})
    yield "YAML merges", pack({**sample, CONFIG: b"shape: {<<: {<<: {<<: [{}, {}]}}}"})
    for number in (0, -1, 1e-300, float("nan"), float("inf"), 10**30):
        yield f"dt {number}", pack(edited(sample, RECORD, dt=number))
        yield f"success_threshold {number}", pack(edited(sample, RECORD, success_threshold=number))
    yield "image of 10^9 pixels", pack(edited(sample, RECORD, image=[_HUGE, _HUGE]))


def _tensors(sample: Members) -> Crafted:
    for member in (WEIGHTS, STATISTICS):
        data = sample[member]
        length = int.from_bytes(data[:8], "little")
        header, body = json.loads(data[8 : 8 + length]), data[8 + length :]
        name = next(iter(header))
        yield f"{member}: header of 2^63 bytes", pack({**sample, member: struct.pack("<Q", 2**63) + data[8:]})
        yield f"{member}: deep header", pack({**sample, member: _tensor_file(b"[" * 500_000, body)})
        yield f"{member}: empty", pack({**sample, member: b""})
        for what, entry in (
            ("shape 2^62", {"shape": [2**62, 4]}),
            ("shape of zeros", {"shape": [0, 2**60], "data_offsets": [0, 0]}),
            ("negative shape", {"shape": [-1, -len(body)]}),
            ("shape in floats", {"shape": [1e308]}),
            ("10^5 sides", {"shape": [1] * 100_000}),
            ("dtype of objects", {"dtype": "O"}),
            ("dtype in a list", {"dtype": ["F32"]}),
            ("offsets behind the end", {"data_offsets": [0, 2**60]}),
            ("negative offsets", {"data_offsets": [-8, 8]}),
            ("offsets of another", {"data_offsets": header[list(header)[-1]]["data_offsets"]}),
        ):
            changed = {**header, name: {**header[name], **entry}}
            yield f"{member}: {what}", pack({**sample, member: _tensor_file(json.dumps(changed).encode(), body)})
        nan = np.full(len(body) // 4, np.nan, np.float32).tobytes()
        yield f"{member}: not finite", pack({**sample, member: data[: 8 + length] + nan + body[len(nan) :]})


def _deflated(data: bytes) -> bytes:
    packer = zlib.compressobj(wbits=-15)
    return packer.compress(data) + packer.flush()


def _tensor_file(header: bytes, body: bytes) -> bytes:
    return struct.pack("<Q", len(header)) + header + body


def _directory(entries: bytes, count: int, start: int) -> bytes:
    """Return a directory and the end of a zip."""
    return entries + struct.pack("<4s4H2LH", b"PK\x05\x06", 0, 0, count, count, len(entries), start, 0)


def _flagged(plain: bytes, offset: int, value: int) -> bytes:
    """Return a zip with one value replaced in the header of its first member, and in its directory."""
    data = bytearray(plain)
    data[offset : offset + 2] = struct.pack("<H", value)
    at = plain.index(b"PK\x01\x02") + offset + 2
    data[at : at + 2] = struct.pack("<H", value)
    return bytes(data)


def _with_manifest(members: Members) -> Members:
    with zipfile.ZipFile(io.BytesIO(pack(members))) as archive:
        return {name: archive.read(name) for name in archive.namelist()}
