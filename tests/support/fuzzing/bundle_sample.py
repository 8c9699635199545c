"""A small policy as a bundle, to be damaged, and the members of a bundle as a zip that need not be a valid one."""

from __future__ import annotations

import hashlib
import io
import json
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import gymnasium as gym
import numpy as np

from shape_obs.deploy.policy_bundle.archive import FORMAT, STATISTICS, VERSION, WEIGHTS, read_archive
from shape_obs.features import PointDistribution
from shape_obs.geometry.topology import Chain

#: Suffix of files that are loaded with ``trust=True``.
TRUSTED: Final = ".trusted"
_POINTS: Final = 20
_SHAPES: Final = 40
_DATE: Final = (1980, 1, 1, 0, 0, 0)
Members = dict[str, bytes]


def save_sample(folder: Path) -> Path:
    """Save an untrained policy of the cable that reads fitted features, with statistics, a goal and own extractor."""
    import stable_baselines3 as sb3
    import torch
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    import shape_obs_envs  # noqa: F401 - registers the environments
    from shape_obs import ShapeObservation, save_bundle
    from shape_obs.training import Curriculum, GoalDifference

    torch.set_num_threads(1)
    fitted = folder / "ropes.npz"
    _fitted().save(fitted)
    features = [{"kind": "points3d", "frame": "base"}, {"kind": "pca", "file": str(fitted)}]

    def make() -> Any:
        env = gym.make("ShapeObs/Cable-v0", camera=[84, 84], disable_env_checker=True)
        return Curriculum(ShapeObservation(env, features=features), ["near"])

    env = VecNormalize(DummyVecEnv([make]), norm_reward=False)
    policy = {"net_arch": [16], "features_extractor_class": GoalDifference}
    model = sb3.SAC("MultiInputPolicy", env, policy_kwargs=policy, buffer_size=10, seed=0, device="cpu")
    path = folder / "sample.policy"
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)  # nothing in it takes trust
        save_bundle(model, env, path)
    return path


def members_of(path: Path) -> Members:
    """Return the members of a bundle, without its manifest."""
    return read_archive(path).members


def pack(members: Mapping[str, bytes], /, *, version: Any = VERSION, **manifest: Any) -> bytes:
    """Make a bundle of any members, with checksums that fit; entries of the manifest may be replaced."""
    listed = {name: {"sha256": hashlib.sha256(data).hexdigest(), "size": len(data)} for name, data in members.items()}
    head = {"format": FORMAT, "version": version, "members": listed, **manifest}
    return pack_plain({"manifest.json": json.dumps(head).encode(), **members})


def pack_plain(members: Mapping[str, bytes]) -> bytes:
    """Make a zip as ``save_bundle`` does, without its own manifest."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, data in members.items():
            method = zipfile.ZIP_STORED if name in (WEIGHTS, STATISTICS) else zipfile.ZIP_DEFLATED
            archive.writestr(zipfile.ZipInfo(name, _DATE), data, method, compresslevel=1)
    return buffer.getvalue()


def edited(members: Mapping[str, bytes], name: str, **changes: Any) -> Members:
    """Return the members with entries of one JSON document replaced."""
    return {**members, name: json.dumps({**json.loads(members[name]), **changes}).encode()}


def _fitted() -> PointDistribution:
    """Return principal components of smooth curves on a table."""
    rng = np.random.default_rng(0)
    along = np.linspace(-0.2, 0.2, _POINTS)
    bends = rng.normal(scale=0.03, size=(_SHAPES, 4))
    shapes = np.zeros((_SHAPES, _POINTS, 3))
    shapes[..., 0] = along
    shapes[..., 1] = sum(bends[:, [k]] * np.sin((k + 1) * np.pi * along / 0.2) for k in range(4))
    return PointDistribution.fit(shapes, 3, layout=Chain(_POINTS), frame="base")
