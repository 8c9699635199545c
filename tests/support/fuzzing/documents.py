"""Damage configs, goals, studies and calibration files: only declared errors come out."""

from __future__ import annotations

import io
import json
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from fuzzing.damage import Outcome, Outcomes, mutate, mutate_bytes
from shape_obs.ablation import load_study
from shape_obs.calibration.intrinsics import IntrinsicsFit
from shape_obs.calibration.touch_points import read_touches
from shape_obs.camera import Intrinsics
from shape_obs.config.config_file import detector_arguments, dump_config, load_config
from shape_obs.detector import ShapeDetector
from shape_obs.extrinsics import Extrinsics
from shape_obs.features import PointDistribution
from shape_obs.geometry.topology import Chain
from shape_obs.utils.arrays import decode_npz
from shape_obs.utils.documents import read_yaml
from shape_obs.wrappers.target import Target


@dataclass(frozen=True)
class Kind:
    """A kind of file.

    Attributes:
        name: The file's name.
        value: What a right file holds.
        dump: Turns a value into the file's content.
        read: Reads the file.
    """

    name: str
    value: Any
    dump: Callable[[Any], bytes]
    read: Callable[[Path], object]


def damaged_documents(kind: Kind, folder: Path, count: int, seed: int) -> Counter[Outcome]:
    """Change values or text of a file, again and again, read it, and count the outcomes."""
    draw, outcomes, path = np.random.default_rng(seed), Outcomes(ValueError, OSError), folder / kind.name
    whole = kind.dump(kind.value)
    path.write_bytes(whole)
    kind.read(path)
    for i in range(count):
        path.write_bytes(mutate_bytes(whole, draw) if i % 2 else kind.dump(mutate(kind.value, draw)))
        outcomes.try_out(f"{kind.name} {i}", lambda: kind.read(path))
    return outcomes.counts


def kinds() -> list[Kind]:
    """Return the kinds of files, each with a right one."""
    config: Mapping[str, Any] = {
        "shapes": [{"kind": "centerline", "name": "rope", "n": 8, "anchor": [0.1, 0.2, 0.3]}, {"kind": "contour"}],
        "segmentation": {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]},
        "roi": {"kind": "rectangle", "left": 1, "top": 2, "width": 100, "height": 80},
        "features": ["points3d", {"kind": "fourier", "harmonics": 3}],
        "workspace": [[-1, -1, -1], [1, 1, 1]],
        "backend": "numpy",
    }
    pinhole = Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5)
    place = Extrinsics(tuple(map(tuple, np.eye(4).tolist())), pinhole, "123", 0.001)
    points = [[0.1 * i, 0.0, 0.01] for i in range(8)]
    study = {
        "version": 1, "episode": 10, "seeds": [0, 1], "steps": 60, "her": {}, "normalize": {"gamma": 0.98},
        "evaluation": {"every": 30, "goals": 1, "disturbances": {"noisy": {"noise": {}}}},
        "arms": {"truth": {"observation": "truth", "hyperparameters": {"net_arch": [8]}}, "points": {}},
    }  # fmt: skip
    goal = Target(tuple(map(tuple, points)), layout={"kind": "centerline"}).to_dict()
    touches = [{"marker": 3, "corner": i, "x": 0.1, "y": 0.2, "z": 0.3} for i in range(4)]
    fit = IntrinsicsFit(pinhole, 0.2, 0.001, 12, 0.9).to_dict()
    return [
        Kind("config.yaml", yaml.safe_load(dump_config(config)), _yaml, _read_config),
        Kind("goal.yaml", {"version": 1, "goal": goal}, _yaml, lambda path: Target.load(path).to_dict()),
        Kind("study.yaml", study, _yaml, lambda path: load_study(path).to_dict()),
        Kind("extrinsics.json", place.to_dict(), _json, _read_extrinsics),
        Kind("intrinsics.json", fit, _json, lambda path: IntrinsicsFit.load(path).to_dict()),
        Kind("touches.json", touches, _json, read_touches),
        Kind("touches.csv", touches, _csv, read_touches),
        Kind("principal_components.npz", *_model_file(), _read_model),
        Kind("setting.yaml", {"camera": [96, 72], "seed": 3}, _yaml, lambda path: read_yaml(path, "setting")),
    ]


def _read_config(path: Path) -> object:
    arguments = load_config(path)
    return ShapeDetector(**detector_arguments(arguments)).config.to_dict()


def _read_extrinsics(path: Path) -> object:
    place = Extrinsics.load(path)
    return place.doubts(Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5), "123")


def _read_model(path: Path) -> object:
    model = PointDistribution.load(path)
    return model.values(model.mean, np.ones(len(model.mean)))


def _yaml(value: Any) -> bytes:
    return yaml.safe_dump(value, sort_keys=False, allow_unicode=True).encode("utf-8", "surrogatepass")


def _json(value: Any) -> bytes:
    return json.dumps(value).encode()


def _csv(value: Any) -> bytes:
    rows = value if isinstance(value, list) else [value]
    lines = [",".join(map(str, row.values())) if isinstance(row, dict) else str(row) for row in rows]
    return "\n".join(["marker,corner,x,y,z", *lines]).encode("utf-8", "surrogatepass")


def _model_file() -> tuple[dict[str, Any], Callable[[Any], bytes]]:
    """Return the metadata of a file of principal components, and a function that puts other metadata into it."""
    shapes = np.random.default_rng(0).normal(size=(20, 8, 3))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "model.npz")
        PointDistribution.fit(shapes, 2, layout=Chain(8), frame="camera").save(path)
        arrays = decode_npz(path.read_bytes(), path.name)
    metadata = json.loads(str(arrays.pop("metadata")))

    def dump(value: Any) -> bytes:
        stream = io.BytesIO()
        np.savez(stream, metadata=np.array(json.dumps(value)), **arrays)  # type: ignore[arg-type]
        return stream.getvalue()

    return metadata, dump
