"""Crafted bundles that are well-formed and ask for huge networks, spaces, shapes, images and fitted files."""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from fuzzing.bundle_sample import Members, edited, pack, pack_plain
from shape_obs.deploy.policy_bundle.archive import CONFIG, ENV, RECORD

Crafted = Iterator[tuple[str, bytes]]
_BOMB: Final = 256 * 2**20
_HUGE: Final = 10**9


def sizes(sample: Members) -> Crafted:
    """Yield files whose values demand many resources: (name, content)."""
    for group in (_networks, _spaces, _configurations, _environments, _fitted):
        yield from group(sample)


def _networks(sample: Members) -> Crafted:
    network = json.loads(sample[RECORD])["network"]
    for name, value in (
        ("net_arch", [_HUGE]), ("net_arch", [16_384] * 16), ("net_arch", [1] * 100_000), ("net_arch", {"pi": [_HUGE]}),
        ("net_arch", [[[16]]]), ("net_arch", [0]), ("net_arch", [-1]), ("net_arch", [1.5]), ("net_arch", [True]),
        ("n_critics", 10**6), ("n_critics", -1), ("clip_mean", float("nan")), ("log_std_init", 1e300),
        ("features_extractor_kwargs", {"visible": -5}), ("features_extractor_kwargs", {"visible": 1000}),
        ("features_extractor_kwargs", {"features": _HUGE}), ("features_extractor_class", "NatureCNN"),
        ("use_sde", True), ("use_sde", 1), ("normalize_images", "yes"), ("unknown", 1), ("activation_fn", "Softmax2d"),
    ):  # fmt: skip
        arguments = {**network["arguments"], name: value}
        yield f"{name}={str(value)[:40]}", pack(edited(sample, RECORD, network={**network, "arguments": arguments}))
    for name, value in (("algorithm", "PPO"), ("policy", "CnnPolicy"), ("policy", "__class__"), ("arguments", None)):
        yield f"network's {name}={value}", pack(edited(sample, RECORD, network={**network, name: value}))


def _spaces(sample: Members) -> Crafted:
    record = json.loads(sample[RECORD])
    box: dict[str, Any] = {"kind": "box", "dtype": "float32", "low": -1.0, "high": 1.0}
    nested: dict[str, Any] = {**box, "shape": [1]}
    for _ in range(10):
        nested = {"kind": "dict", "spaces": {"a": nested}}
    for what, space in (
        ("10^12 numbers", {**box, "shape": [10**6, 10**6]}),
        ("2^60 numbers", {**box, "shape": [2**60]}),
        ("negative", {**box, "shape": [-1, -(10**9)]}),
        ("objects", {**box, "shape": [1], "dtype": "object"}),
        ("10^5 sides", {**box, "shape": [1] * 100_000}),
        ("bounds of another shape", {**box, "shape": [3], "low": [[0.0] * 100] * 100}),
        ("bounds that are no numbers", {**box, "shape": [3], "low": "nan"}),
        ("nan bounds", {**box, "shape": [3], "low": float("nan")}),
        ("discrete 10^12", {"kind": "discrete", "n": 10**12, "start": 0}),
        ("multidiscrete", {"kind": "multidiscrete", "nvec": [10**6] * 10_000}),
        ("multibinary", {"kind": "multibinary", "n": 10**12}),
        ("nested", nested),
        ("10^5 keys", {"kind": "dict", "spaces": {str(i): {**box, "shape": [1]} for i in range(20_000)}}),
        ("no keys", {"kind": "dict", "spaces": {}}),
        ("no space", {}),
    ):
        for name in ("observation_space", "action_space"):
            both = {**record, name: space, "network": {**record["network"], name: space}}
            yield f"{name}: {what}", pack({**sample, RECORD: json.dumps(both).encode()})


def _configurations(sample: Members) -> Crafted:
    config, env = sample[CONFIG].decode(), json.loads(sample[ENV])
    for old, new in (
        ("n: 20", f"n: {_HUGE}"), ("n: 20", "n: .nan"), ("open: 0", f"open: {_HUGE}"), ("close: 0", "close: 100000"),
        ("max_age: 0.5", "max_age: .inf"), ("kind: som", f"{{kind: kohonen, steps: {_HUGE}}}"),
        ("  clustering:\n    kind: som", f"  clustering: {{kind: kohonen, steps: {_HUGE}}}"),
        ("  clustering:\n    kind: som", f"  clustering: {{kind: kmeans, n_init: {_HUGE}, max_iter: {_HUGE}}}"),
    ):  # fmt: skip
        yield f"configuration with {new[:40]}", pack({**sample, CONFIG: config.replace(old, new, 1).encode()})
    surface = {"kind": "surface", "rows": 100, "cols": 100}
    for what, kwargs in (
        ("10^4 points", {"shapes": [surface]}),
        ("10^4 shapes", {"shapes": [{"kind": "centerline", "name": str(i)} for i in range(4000)]}),
        ("10^4 features", {"features": ["points3d"] * 10_000}),
        ("10^9 harmonics", {"features": [{"kind": "fourier", "harmonics": _HUGE}]}),
        ("10^9 degrees", {"features": [{"kind": "bezier", "degree": _HUGE}]}),
        ("10^9 coefficients", {"features": [{"kind": "bspline", "coefficients": _HUGE}]}),
        ("many functions on a lattice", {
            "shapes": [{"kind": "surface", "rows": 32, "cols": 32}],
            "features": [{"kind": "bspline", "coefficients": 32, "max_depth": 2.0 + i} for i in range(16)],
        }),
        ("roi of 10^9 pixels", {"roi": {"kind": "rectangle", "left": 0, "top": 0, "width": _HUGE, "height": _HUGE}}),
    ):  # fmt: skip
        changed = [{**env["wrappers"][0], "kwargs": {**env["wrappers"][0]["kwargs"], **kwargs}}]
        yield f"ShapeObservation with {what}", pack(edited(sample, ENV, wrappers=changed))


def _environments(sample: Members) -> Crafted:
    wrappers = json.loads(sample[ENV])["wrappers"]
    for kwargs in (
        {"camera": [4096, 4096]}, {"camera": [10**9, 10**9]}, {"render_size": [4096, 4096]}, {"camera": "huge"},
        {"randomize": {"distractors": {"most": _HUGE}}}, {"randomize": {"table": {"cell": [1e-9, 1e-9]}}},
        {"unknown": 1}, {"grippers": _HUGE}, {"difficulty": ["near"]}, {"camera": [84.0, float("nan")]},
    ):  # fmt: skip
        yield f"Cable-v0 with {kwargs}", pack(edited(sample, ENV, kwargs=kwargs))
    for kwargs in (
        {"rate": 1e-300},
        {"size": [4096, 4096]},
        {"settle": -1},
        {"max_step": [_HUGE] * 1000},
        {"timeout": "x"},
    ):
        yield f"D455-v0 with {str(kwargs)[:40]}", pack(edited(sample, ENV, id="ShapeObs/D455-v0", kwargs=kwargs))
    yield "foreign with 10^9", pack(edited(sample, ENV, id="BundleForeign-v0", kwargs={"size": _HUGE}, wrappers=[]))
    for name, kwargs in (
        ("FrameStackObservation", {"stack_size": _HUGE}), ("ResizeObservation", {"shape": [100_000, 100_000]}),
        ("ResizeObservation", {"shape": _HUGE}), ("ReshapeObservation", {"shape": [2**40]}),
        ("DelayObservation", {"delay": _HUGE}), ("MaxAndSkipObservation", {"skip": _HUGE}),
        ("RescaleAction", {"min_action": [0.0] * 50_000, "max_action": 1}),
        ("TimeLimit", {"max_episode_steps": 10**18}),
        ("FlattenObservation", {"unknown": 1}), ("FilterObservation", {"filter_keys": ["none"]}),
    ):  # fmt: skip
        added = {"name": name, "entry_point": "gymnasium.wrappers:" + name, "kwargs": kwargs}
        yield f"{name} with {str(kwargs)[:40]}", pack(edited(sample, ENV, wrappers=[*wrappers, added]))
    flatten = {"name": "FlattenObservation", "entry_point": "gymnasium.wrappers:FlattenObservation", "kwargs": {}}
    yield "10^4 wrappers", pack(edited(sample, ENV, wrappers=[flatten] * 2000))
    goal = {"points": [[0.0, 0.0, 0.0]] * 10_000, "layout": {"kind": "surface", "rows": _HUGE, "cols": _HUGE}}
    added = {"name": "ShapeGoal", "entry_point": "shape_obs.wrappers.shape_goal:ShapeGoal", "kwargs": {"goal": goal}}
    yield "goal of 10^18 points", pack(edited(sample, ENV, wrappers=[*wrappers, added]))
    points = [[i / 1e4, 0, 0] for i in range(10_000)]
    for layout in ({"kind": "centerline"}, {"kind": "surface", "rows": 100, "cols": 100}):
        kwargs = {"goal": {"points": points, "layout": layout}}
        added = {"name": "ShapeGoal", "entry_point": "shape_obs.wrappers.shape_goal:ShapeGoal", "kwargs": kwargs}
        yield f"goal of 10^4 points of a {layout['kind']}", pack(edited(sample, ENV, wrappers=[*wrappers, added]))
    yield "max_episode_steps", pack(edited(sample, ENV, max_episode_steps=10**18))


def _fitted(sample: Members) -> Crafted:
    name = next(name for name in sample if name.startswith("files/"))
    buffer = io.BytesIO()
    np.save(buffer, np.zeros(_BOMB // 8))
    yield "compressed zeros in a fitted file", pack({**sample, name: pack_plain({"mean.npy": buffer.getvalue()})})
    header = b"\x93NUMPY\x01\x00"
    for what, text in (
        ("10^18 numbers", "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000, 1000000000), }"),
        ("objects", "{'descr': '|O', 'fortran_order': False, 'shape': (3,), }"),
        ("negative", "{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }"),
        ("deep header", "(" * 3000),
        ("code in the header", "__import__('os').system('touch $BUNDLE_CANARY')"),
    ):
        array = header + struct.pack("<H", len(text)) + text.encode()
        yield f"fitted file: {what}", pack({**sample, name: pack_plain({"metadata.npy": array, "mean.npy": array})})
    yield "fitted file: deep metadata", pack({**sample, name: _metadata("[" * 100_000)})
    layout = {"kind": "chain", "count": 10**18}
    head = {"format": "shape_obs point distribution", "version": 1, "layout": layout, "frame": "base", "origin": None}
    yield (
        "fitted file: huge layout",
        pack({**sample, name: _metadata(json.dumps({**head, "aligned": False, "about": {}}))}),
    )


def _metadata(text: str) -> bytes:
    buffer = io.BytesIO()
    arrays = {
        "mean": np.zeros((20, 3)),
        "components": np.zeros((1, 20, 3)),
        "variance": np.ones(1),
        "noise": np.array(1.0),
    }
    np.savez(buffer, metadata=np.array(text), **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()
