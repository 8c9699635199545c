"""Crafted bundles that try to run code: pickles, and import paths in every place that names something."""

from __future__ import annotations

import io
import json
import pickle
import zipfile
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from fuzzing.bundle_canary import MODULE, Touch
from fuzzing.bundle_sample import Members, edited, pack
from shape_obs.deploy.policy_bundle.archive import CONFIG, ENV, RECORD, STATISTICS, WEIGHTS

Crafted = Iterator[tuple[str, bytes]]
_FITTED: Final = "files/0123456789abcdef.npz"


def attacks(sample: Members) -> Crafted:
    """Yield files that name or hold code: (name, content)."""
    for group in (_pickles, _classes, _environments, _wrappers, _plugins, _yaml):
        yield from group(sample)


def _pickles(sample: Members) -> Crafted:
    code = pickle.dumps(Touch())
    yield "pickle as weights", pack({**sample, WEIGHTS: code})
    yield "pickle as statistics", pack({**sample, STATISTICS: code})
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as saved:
        saved.writestr("archive/data.pkl", code)
        saved.writestr("archive/version", "3")
    yield "file of torch.save as weights", pack({**sample, WEIGHTS: archive.getvalue()})
    yield "pickle as fitted file", pack(_with_fitted(sample, code))
    objects = io.BytesIO()
    np.savez(objects, metadata=np.array([Touch()], dtype=object), mean=np.zeros(3))
    yield "objects in a fitted file", pack(_with_fitted(sample, objects.getvalue()))
    model = io.BytesIO()
    with zipfile.ZipFile(model, "w") as saved:
        saved.writestr("data", json.dumps({"policy_class": {":type:": "x", ":serialized:": _base64(code)}}))
        saved.writestr("policy.pth", code)
    yield "version 1 with a pickled model", pack({**_old(sample), "model.zip": model.getvalue()}, version=1)
    yield "model.zip next to the weights", pack({**sample, "model.zip": model.getvalue()})


def _classes(sample: Members) -> Crafted:
    network = json.loads(sample[RECORD])["network"]
    canary = f"{MODULE}:Class"
    for name in ("policy", "algorithm"):
        yield f"import path as {name}", _network(sample, {**network, name: canary})
    for name in ("activation_fn", "features_extractor_class", "optimizer_class", "net_arch", "lr_schedule"):
        yield (
            f"import path as {name}",
            _network(sample, {**network, "arguments": {**network["arguments"], name: canary}}),
        )
    inner = {"features_extractor_kwargs": {"activation_fn": canary}}
    yield "import path within extractor", _network(sample, {**network, "arguments": {**network["arguments"], **inner}})
    yield "import path as record's algorithm", pack(edited(sample, RECORD, algorithm=canary))


def _environments(sample: Members) -> Crafted:
    canary = f"{MODULE}:Class"
    env = json.loads(sample[ENV])
    yield "module in id", pack(edited(sample, ENV, id=f"{MODULE}:Env-v0"))
    yield "module and namespace in id", pack(edited(sample, ENV, id=f"{MODULE}:ShapeObs/Cable-v0"))
    yield "entry point of a known id", pack(edited(sample, ENV, entry_point=canary))
    yield "entry point of an unknown id", pack(edited(sample, ENV, id="Unknown-v0", entry_point=canary))
    yield "vector entry point", pack(edited(sample, ENV, vector_entry_point=canary))
    yield "spec of Gymnasium", pack({**sample, ENV: json.dumps({**env, "additional_wrappers": []}).encode()})
    for name, value in (
        ("robot", canary),
        ("source", f"{MODULE}:Env-v0"),
        ("source", "/dev/zero"),
        ("extrinsics", "/dev/zero"),
        ("robot", [canary]),
    ):
        kwargs = {"source": "d455", name: value}
        yield (
            f"D455-v0 with {name}={value!r}",
            pack(edited(sample, ENV, **_own("ShapeObs/D455-v0", kwargs))),
        )
    for value in (canary, {"deep": [canary]}, f"../{MODULE}.py", f"{MODULE}.Class"):
        kwargs = {"plugin": value}
        yield f"foreign with {value!r}", pack(edited(sample, ENV, **_own("BundleForeign-v0", kwargs)))


def _own(name: str, kwargs: dict[str, Any]) -> dict[str, Any]:
    """Return changes of the environment's document: a registered id with arguments and without wrappers."""
    return {"id": name, "entry_point": None, "kwargs": kwargs, "wrappers": []}


def _wrappers(sample: Members) -> Crafted:
    wrappers = json.loads(sample[ENV])["wrappers"]
    for name, path in (
        ("Canary", f"{MODULE}:Canary"),
        ("ShapeGoal", f"{MODULE}:ShapeGoal"),
        ("FlattenObservation", f"{MODULE}:FlattenObservation"),
        ("FlattenObservation", f"gymnasium.wrappers.{MODULE}:FlattenObservation"),
        ("FlattenObservation", f"{MODULE}:gymnasium.wrappers:FlattenObservation"),
        ("RecordVideo", "gymnasium.wrappers:RecordVideo"),
        ("TransformObservation", "gymnasium.wrappers:TransformObservation"),
    ):
        kwargs = (
            {"video_folder": ".", "func": f"{MODULE}:Class"} if name not in ("ShapeGoal", "FlattenObservation") else {}
        )
        added = {"name": name, "entry_point": path, "kwargs": kwargs}
        yield f"wrapper {name} from {path}", pack(edited(sample, ENV, wrappers=[*wrappers, added]))
    first = {**wrappers[0], "entry_point": f"{MODULE}:ShapeObservation"}
    yield "ShapeObservation from elsewhere", pack(edited(sample, ENV, wrappers=[first, *wrappers[1:]]))


def _plugins(sample: Members) -> Crafted:
    """Yield kinds of a plugin that is installed and not imported, and a feature that reads any file."""
    env, config = json.loads(sample[ENV]), sample[CONFIG].decode()
    shape = env["wrappers"][0]
    goal = {"points": [[0.0, 0.0, 0.0]] * 4, "configuration": {"kind": "canary"}}
    for where, kwargs in (
        ("features", {"features": [{"kind": "canary"}]}),
        ("features by name", {"features": ["canary"]}),
        ("segmentation", {"segmentation": {"kind": "canary"}}),
        ("shapes", {"shapes": [{"kind": "canary"}]}),
        ("roi", {"roi": {"kind": "canary"}}),
        ("clustering", {"clustering": "canary"}),
        ("a shape's segmentation", {"shapes": [{"kind": "centerline", "segmentation": {"kind": "canary"}}]}),
    ):
        changed = [{**shape, "kwargs": {**shape["kwargs"], **kwargs}}]
        yield f"plugin in {where}", pack(edited(sample, ENV, wrappers=changed))
    for where, kwargs in (("goal", {"goal": goal}), ("goal's features", {"features": ["canary"]})):
        added = {"name": "ShapeGoal", "entry_point": "shape_obs.wrappers.shape_goal:ShapeGoal", "kwargs": kwargs}
        yield f"plugin in {where}", pack(edited(sample, ENV, wrappers=[*env["wrappers"], added]))
    for old, new in (("kind: hsv", "kind: canary"), ("kind: points3d", "kind: canary"), ("kind: som", "kind: canary")):
        yield f"plugin for {old} in the configuration", pack({**sample, CONFIG: config.replace(old, new).encode()})
    fitted = next(name for name in sample if name.startswith("files/"))
    for path in ("/dev/zero", "../../../../../../dev/zero", f"files/../{MODULE}.py", "files/", ""):
        text = config.replace(fitted, json.dumps(path))
        yield f"fitted file {path!r}", pack({**sample, CONFIG: text.encode()})


def _yaml(sample: Members) -> Crafted:
    config = sample[CONFIG].decode()
    for tag in (
        "!!python/object/apply:os.system ['touch \"$BUNDLE_CANARY\"']",
        f"!!python/object/new:{MODULE}.Class []",
        f"!!python/name:{MODULE}.Class",
        f"!!python/module:{MODULE}",
    ):
        yield (
            f"YAML tag {tag[:40]}",
            pack({**sample, CONFIG: config.replace("max_age: 0.5", f"max_age: {tag}").encode()}),
        )


def _network(sample: Members, network: dict[str, Any]) -> bytes:
    return pack(edited(sample, RECORD, network=network))


def _old(sample: Members) -> Members:
    """Return the members as in version 1, without the model."""
    record = {name: value for name, value in json.loads(sample[RECORD]).items() if name != "network"}
    record["algorithm"] = "stable_baselines3:SAC"
    env = {"id": "ShapeObs/Cable-v0", "entry_point": "shape_obs_envs.mujoco.cable:CableEnv", "additional_wrappers": []}
    kept = {name: data for name, data in sample.items() if name not in (WEIGHTS, STATISTICS)}
    return {**kept, RECORD: json.dumps(record).encode(), ENV: json.dumps(env).encode()}


def _with_fitted(sample: Members, data: bytes) -> Members:
    """Return the sample with another fitted file, which its configuration and its environment read."""
    fitted = next(name for name in sample if name.startswith("files/"))
    moved = {
        name: content.replace(fitted.encode(), _FITTED.encode()) for name, content in sample.items() if name != fitted
    }
    return {**moved, _FITTED: data}


def _base64(data: bytes) -> str:
    import base64

    return base64.b64encode(data).decode()
