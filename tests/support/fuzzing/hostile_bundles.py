"""Bundles that are damaged at random, or crafted to run code or to take memory, time or files."""

from __future__ import annotations

import base64
import hashlib
import io
import json
import os
import pickle
import stat
import struct
import zipfile
from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
import yaml

from fuzzing.damage import flip, mutate, mutate_bytes
from shape_obs.deploy.policy_bundle.archive import CONFIG, ENV, FORMAT, RECORD, STATISTICS, VERSION, WEIGHTS

#: The module of the canary, and the environment variable with the path of the file that its code makes.
MODULE: Final = "bundle_canary"
VARIABLE: Final = "BUNDLE_CANARY"
_CODE: Final = f"{MODULE}:Class"
_BOMB: Final = 256 * 2**20
_HUGE: Final = 10**9
_DATE: Final = (1980, 1, 1, 0, 0, 0)
_FITTED: Final = "files/0123456789abcdef.npz"
_POINTS: Final = [[i / 1e4, 0, 0] for i in range(10_000)]

Members = Mapping[str, bytes]
Named = Iterator[tuple[str, bytes]]


class Touch:
    """An object that makes the canary's file when it is unpickled."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        """Name a function of the operating system, as a hostile pickle does."""
        return os.system, (f'touch "${VARIABLE}"',)


def _wrapper(name: str, path: str = "gymnasium.wrappers", **kwargs: Any) -> dict[str, Any]:
    return {"name": name, "entry_point": path if ":" in path else f"{path}:{name}", "kwargs": kwargs}


def _goal(**goal: Any) -> dict[str, Any]:
    return _wrapper("ShapeGoal", "shape_obs.wrappers.shape_goal:ShapeGoal", goal=goal)


_BOX: Final = {"kind": "box", "dtype": "float32", "low": -1.0, "high": 1.0}
_SPACES: Final[tuple[Any, ...]] = (
    {**_BOX, "shape": [10**6, 10**6]}, {**_BOX, "shape": [-1, -_HUGE]}, {**_BOX, "shape": [1], "dtype": "object"},
    {**_BOX, "shape": [3], "low": [[0.0] * 100] * 100}, {"kind": "discrete", "n": 10**12, "start": 0}, {},
    {"kind": "dict", "spaces": {str(i): {**_BOX, "shape": [1]} for i in range(20_000)}},
)  # fmt: skip
#: What stands at a place of a document, given by the keys that lead to it: code, files, what is huge or impossible.
_VALUES: Final[tuple[tuple[str, str, tuple[Any, ...]], ...]] = (
    (RECORD, "algorithm", (_CODE,)),
    (RECORD, "dt", (0, 1e-300, float("nan"), 10**30)),
    (RECORD, "image", ([_HUGE, _HUGE],)),
    (RECORD, "network policy", (_CODE, "__class__")),
    (RECORD, "network arguments", (None,)),
    (RECORD, "network arguments net_arch", (_CODE, [_HUGE], [16_384] * 16, [1] * 100_000, {"pi": [_HUGE]}, [[[16]]])),
    (RECORD, "network arguments activation_fn", (_CODE, "Softmax2d")),
    (RECORD, "network arguments features_extractor_class", (_CODE, "NatureCNN")),
    (RECORD, "network arguments features_extractor_kwargs", ({"activation_fn": _CODE}, {"features": _HUGE})),
    (RECORD, "network arguments n_critics", (10**6, -1)),
    (ENV, "id", (f"{MODULE}:Env-v0", f"{MODULE}:ShapeObs/Cable-v0", "Unknown-v0")),
    (ENV, "entry_point", (_CODE,)),
    (ENV, "vector_entry_point", (_CODE,)),
    (ENV, "kwargs", (
        {"camera": [_HUGE, _HUGE]}, {"grippers": _HUGE}, {"randomize": {"distractors": {"most": _HUGE}}},
        {"unknown": 1}, {"camera": [84.0, float("nan")]},
    )),
    (ENV, "wrappers 0 entry_point", (f"{MODULE}:ShapeObservation",)),
    (ENV, "wrappers 0 kwargs features", (
        [{"kind": "canary"}], ["points3d"] * 10_000, [{"kind": "fourier", "harmonics": _HUGE}],
    )),
    (ENV, "wrappers 0 kwargs shapes", (
        [{"kind": "canary"}], [{"kind": "centerline", "segmentation": {"kind": "canary"}}],
        [{"kind": "surface", "rows": 100, "cols": 100}],
        [{"kind": "centerline", "name": str(i)} for i in range(4000)],
    )),
    (ENV, "wrappers 0 kwargs segmentation", ({"kind": "canary"},)),
    (ENV, "wrappers 0 kwargs clustering", ("canary",)),
    (ENV, "wrappers 0 kwargs roi", ({"kind": "canary"},)),
    (ENV, "wrappers 1", (
        _wrapper("FlattenObservation", MODULE), _wrapper("FlattenObservation", f"gymnasium.wrappers.{MODULE}"),
        _wrapper("FlattenObservation", f"{MODULE}:gymnasium.wrappers:FlattenObservation"),
        _wrapper("RecordVideo", video_folder="."), _wrapper("TransformObservation", func=_CODE),
        _wrapper("FrameStackObservation", stack_size=_HUGE), _wrapper("ReshapeObservation", shape=[2**40]),
        _wrapper("RescaleAction", min_action=[0.0] * 50_000, max_action=1), _wrapper("FlattenObservation", unknown=1),
        _goal(points=[[0.0] * 3] * 4, configuration={"kind": "canary"}),
        _goal(points=_POINTS, layout={"kind": "surface", "rows": _HUGE, "cols": _HUGE}),
    )),
    (ENV, "wrappers", ([_wrapper("FlattenObservation")] * 2000,)),
    (CONFIG, "shape shapes 0 n", (_HUGE, float("nan"))),
    (CONFIG, "shape clustering", ({"kind": "canary"}, {"kind": "kohonen", "steps": _HUGE})),
    (CONFIG, "shape features 1 file", ("/dev/zero", f"files/../{MODULE}.py", "files/")),
    (CONFIG, "scene segmentation", ({"kind": "canary"}, f"{MODULE}:function")),
)  # fmt: skip
#: Environments and their arguments.
_ENVIRONMENTS: Final = (
    *(("ShapeObs/D455-v0", kwargs) for kwargs in (
        {"source": "d455", "robot": _CODE}, {"source": f"{MODULE}:Env-v0"}, {"source": "/dev/zero"},
        {"extrinsics": "/dev/zero"}, {"rate": 1e-300}, {"settle": -1},
    )),
    *(("BundleForeign-v0", {"plugin": value}) for value in (_CODE, {"deep": [_CODE]}, f"../{MODULE}.py")),
    ("BundleForeign-v0", {"size": _HUGE}),
)  # fmt: skip


def crafted(sample: Members) -> Named:
    """Yield crafted files: (name, content)."""
    for group in (_values, _texts, _archives, _tensors, _pickles):
        yield from group(sample)


def damaged(sample: Members, count: int, seed: int) -> Named:
    """Yield files with random damage: of the file, and within its members with checksums that fit again."""
    draw, plain = np.random.default_rng(seed), pack(sample)
    for number in range(count):
        name = list(sample)[draw.integers(len(sample))]
        data, way = sample[name], number % 4
        if way == 0:
            content = flip(plain, int(draw.integers(8 * len(plain))))
        elif way == 1:
            content = mutate_bytes(plain, draw)
        elif way == 2 or name.startswith("files/"):
            content = pack({**sample, name: mutate_bytes(data, draw)})
        elif name in (WEIGHTS, STATISTICS):
            header, body = _parts(data)
            content = pack({**sample, name: _tensor_file(json.dumps(mutate(header, draw)).encode(), body)})
        else:
            content = pack({**sample, name: _dumped(name, mutate(_loaded(name, data), draw))})
        yield f"{number}: damaged {name}", content


def pack(members: Members, /, *, version: Any = VERSION, **manifest: Any) -> bytes:
    """Make a bundle of any members, with checksums that fit; entries of the manifest may be replaced."""
    listed = {name: {"sha256": hashlib.sha256(data).hexdigest(), "size": len(data)} for name, data in members.items()}
    head = {"format": FORMAT, "version": version, "members": listed, **manifest}
    return _zip({"manifest.json": json.dumps(head).encode(), **members})


def _zip(members: Members) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, data in members.items():
            method = zipfile.ZIP_STORED if name in (WEIGHTS, STATISTICS) else zipfile.ZIP_DEFLATED
            archive.writestr(zipfile.ZipInfo(name, _DATE), data, method, compresslevel=1)
    return buffer.getvalue()


def _loaded(member: str, data: bytes) -> Any:
    return yaml.safe_load(data) if member == CONFIG else json.loads(data)


def _dumped(member: str, value: Any) -> bytes:
    text = yaml.safe_dump(value, allow_unicode=True) if member == CONFIG else json.dumps(value)
    return text.encode("utf-8", "surrogatepass")


def _values(sample: Members) -> Named:
    for member, place, values in _VALUES:
        for value in values:
            document = _loaded(member, sample[member])
            *way, last = (int(key) if key.isdecimal() else key for key in place.split())
            holder = document
            for key in way:
                holder = holder[key]
            holder[last] = value
            yield f"{member}: {place} {value!r:.60}", pack({**sample, member: _dumped(member, document)})
    record, env = json.loads(sample[RECORD]), json.loads(sample[ENV])
    for space in _SPACES:
        for name in ("observation_space", "action_space"):
            both = {**record, name: space, "network": {**record["network"], name: space}}
            yield f"{name} {space!r:.60}", pack({**sample, RECORD: json.dumps(both).encode()})
    for name, kwargs in _ENVIRONMENTS:
        other = {**env, "id": name, "entry_point": None, "kwargs": kwargs, "wrappers": []}
        yield f"{name} {kwargs!r:.60}", pack({**sample, ENV: json.dumps(other).encode()})


def _texts(sample: Members) -> Named:
    for data in (b'{"a":' * 30_000 + b"1" + b"}" * 30_000, b'{"a":' + b"[" * 100_000, b'{"a":' + b"9" * 200_000 + b"}"):
        for member in (RECORD, ENV):
            yield f"{member} {data[:9]}", pack({**sample, member: data})
        yield f"manifest {data[:9]}", _zip({**sample, "manifest.json": data[:60_000]})
    for what in ([], None, [{}]):
        yield f"env.json is {what!r}", pack({**sample, ENV: json.dumps(what).encode()})
        yield f"manifest lists {what!r}", pack(sample, members=what)
        yield f"version {what!r}", pack(sample, version=what)
    config = sample[CONFIG].decode()
    aliases = "a0: &a0 [x, x]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 40))
    for data in (
        aliases, "shape: &a {shapes: *a}", "[" * 30_000, "shape: " + "9" * 32_000, "shape: {<<: {<<: [{}, {}]}}",
        *(config.replace("max_age: 0.5", f"max_age: {tag}") for tag in (
            f"!!python/object/apply:os.system ['touch \"${VARIABLE}\"']", f"!!python/object/new:{MODULE}.Class []",
            f"!!python/name:{MODULE}.Class", f"!!python/module:{MODULE}",
        )),
    ):  # fmt: skip
        yield f"YAML {data[:20]!r}", pack({**sample, CONFIG: data.encode()})


def _archives(sample: Members) -> Named:
    zeros, plain = bytes(_BOMB), pack(sample)
    packed = pack({**sample, RECORD: zeros})
    yield "zip bomb", packed
    yield "zip bomb in the manifest", _zip({"manifest.json": zeros})
    false = packed.replace(struct.pack("<L", _BOMB), struct.pack("<L", 1000))
    yield "zip bomb of a size that it does not declare", false
    start = plain.index(b"PK\x01\x02")
    first = plain[start : plain.index(b"PK\x01\x02", start + 4)]
    for name, entries, count in (
        ("overlapping members", first + plain[start:-22], len(sample) + 2),
        ("many entries of one member", first * 60_000, 60_000),
    ):
        end = struct.pack("<4s4H2LH", b"PK\x05\x06", 0, 0, count, count, len(entries), start, 0)
        yield name, plain[:start] + entries + end
    locator = struct.pack("<4sLQL", b"PK\x06\x07", 0, start, 1)
    record = struct.pack("<4sQ2H2L4Q", b"PK\x06\x06", 44, 45, 45, 0, 0, 2**40, 2**40, 2**50, start)
    yield "zip64 with false sizes", plain[:-22] + record + locator + plain[-22:]
    yield "program before the zip", b"#!/bin/sh\ntouch $BUNDLE_CANARY\n" + plain
    yield "many fitted files", pack({**sample, **{f"files/{i:016x}.npz": b"x" for i in range(100)}})
    for name in (
        "../escaped",
        "/tmp/escaped",
        "files\\..\\escaped",
        "files/",
        f"{_FITTED}/x",
        f"{_FITTED}\0.policy",
        "",
    ):
        yield f"member {name!r}", pack({**sample, name: b"escaped"})
    with zipfile.ZipFile(io.BytesIO(plain)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    for what, method, link, more in (
        ("symbolic link", zipfile.ZIP_STORED, WEIGHTS, []), ("compressed by LZMA", zipfile.ZIP_LZMA, "", []),
        ("compressed weights", zipfile.ZIP_DEFLATED, "", []),
        ("a name twice", zipfile.ZIP_STORED, "", [("policy.jsoM", b"{}")]),
    ):  # fmt: skip
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w", method) as archive:
            for name, data in [*members.items(), *more]:
                info = zipfile.ZipInfo(name, _DATE)
                info.external_attr = (stat.S_IFLNK | 0o777) << 16 if name == link else 0o600 << 16
                archive.writestr(info, b"/etc/passwd" if name == link else data, method)
        yield what, buffer.getvalue().replace(b"policy.jsoM", RECORD.encode())


def _tensors(sample: Members) -> Named:
    for member in (WEIGHTS, STATISTICS):
        header, body = _parts(sample[member])
        name = next(iter(header))
        files = {
            "header of 2^63 bytes": struct.pack("<Q", 2**63) + sample[member][8:],
            "deep header": _tensor_file(b"[" * 500_000, body),
            "empty": b"",
            "not finite": _tensor_file(json.dumps(header).encode(), b"\xff" * len(body)),
        }
        for entry in (
            {"shape": [2**62, 4]}, {"shape": [0, 2**60], "data_offsets": [0, 0]}, {"shape": [1e308]},
            {"shape": [1] * 100_000}, {"dtype": "O"}, {"data_offsets": [0, 2**60]}, {"data_offsets": [-8, 8]},
        ):  # fmt: skip
            changed = {**header, name: {**header[name], **entry}}
            files[f"{entry!r:.60}"] = _tensor_file(json.dumps(changed).encode(), body)
        for what, data in files.items():
            yield f"{member}: {what}", pack({**sample, member: data})


def _pickles(sample: Members) -> Named:
    """Yield files with pickles, and arrays that claim gigabytes."""
    code = pickle.dumps(Touch())
    yield "pickle as weights", pack({**sample, WEIGHTS: code})
    yield "pickle as statistics", pack({**sample, STATISTICS: code})
    saved = io.BytesIO()
    model = {"policy_class": {":type:": "x", ":serialized:": base64.b64encode(code).decode()}}
    np.savez(saved, metadata=np.array([Touch()], dtype=object), mean=np.zeros(3))
    whole = _zip({"data": json.dumps(model).encode(), "policy.pth": code, "archive/data.pkl": code})
    yield "pickles in a zip as weights", pack({**sample, WEIGHTS: whole})
    yield "pickled model next to the weights", pack({**sample, "model.zip": whole})
    old = {name: data for name, data in sample.items() if name not in (WEIGHTS, STATISTICS)}
    record = {**json.loads(sample[RECORD]), "algorithm": "stable_baselines3:SAC"}
    del record["network"]
    env = {"id": "ShapeObs/Cable-v0", "entry_point": "shape_obs_envs.mujoco.cable:CableEnv", "additional_wrappers": []}
    old |= {RECORD: json.dumps(record).encode(), ENV: json.dumps(env).encode(), "model.zip": whole}
    yield "version 1 with a pickled model", pack(old, version=1)
    arrays = [saved.getvalue(), code]
    for text in (
        "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000, 1000000000), }", "(" * 3000,
        "{'descr': '|O', 'fortran_order': False, 'shape': (3,), }", f"__import__('os').system('touch ${VARIABLE}')",
    ):  # fmt: skip
        array = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode()
        arrays.append(_zip({"metadata.npy": array, "mean.npy": array}))
    fitted = next(name for name in sample if name.startswith("files/"))
    moved = {name: data.replace(fitted.encode(), _FITTED.encode()) for name, data in sample.items() if name != fitted}
    for number, data in enumerate(arrays):
        yield f"fitted file {number}", pack({**moved, _FITTED: data})


def _parts(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the header and the body of a file of tensors."""
    end = 8 + int.from_bytes(data[:8], "little")
    return json.loads(data[8:end]), data[end:]


def _tensor_file(header: bytes, body: bytes) -> bytes:
    return struct.pack("<Q", len(header)) + header + body
