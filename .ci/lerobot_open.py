"""Open the datasets of lerobot_make.py with the real lerobot, run by .ci/lerobot in an environment of its own."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import lerobot
import numpy as np
import torch
from lerobot.configs.types import FeatureType
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.datasets.utils import dataset_to_policy_features
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.factory import make_policy, make_pre_post_processors

HORIZON = 4


def rows_of(dataset: LeRobotDataset) -> dict[str, np.ndarray[Any, Any]]:
    """Return all rows of a dataset as arrays by name."""
    items = [dataset[i] for i in range(len(dataset))]
    return {name: np.stack([np.asarray(item[name]) for item in items]) for name in items[0] if name != "task"}


def check_rows(root: Path, wanted: dict[str, np.ndarray[Any, Any]]) -> None:
    """Compare shapes, states, actions, rewards and ends with what a detector of its own found in the recordings."""
    dataset = LeRobotDataset("local/rope", root=root)
    print(dataset)
    rows = rows_of(dataset)
    size = wanted["points"].shape[1]
    pairs = {
        "observation.environment_state": wanted["points"],
        "observation.state": np.concatenate([wanted["points"], wanted["state"]], axis=1),
        "action": wanted["action"],
        "next.reward": wanted["reward"],
    }
    for name, values in pairs.items():
        difference = float(np.abs(rows[name] - values).max())
        print(f"{name:<30} {rows[name].shape}  largest difference {difference:.1e}")
        assert difference <= 1e-6, name
    assert np.array_equal(rows["next.done"], wanted["done"])
    assert rows["shape.ok"].all()
    assert rows["shape.measured"].all()
    assert dataset.features["observation.state"]["names"][:3] == [f"rope/points3d/0/{axis}" for axis in "xyz"]
    assert dataset.features["observation.state"]["names"][size] == "robot/gripper/0"
    assert dataset.features["action"]["names"][0] == "gripper0/x"
    assert (dataset.fps, dataset.num_episodes) == (20, 6)
    assert dataset[0]["task"] == "shape the rope"
    assert np.array_equal(rows["index"], np.arange(len(dataset)))
    starts = [dataset.meta.episodes[i]["dataset_from_index"] for i in range(6)]
    assert np.array_equal(np.flatnonzero(rows["frame_index"] == 0), starts)
    assert np.allclose(rows["timestamp"], rows["frame_index"] / 20)
    for name, values in pairs.items():
        assert np.allclose(dataset.meta.stats[name]["mean"], values.mean(axis=0), atol=1e-5), name
        assert np.allclose(dataset.meta.stats[name]["std"], values.std(axis=0), atol=1e-5), name
    part = LeRobotDataset("local/rope", root=root, episodes=[4])
    assert {int(part[i]["episode_index"]) for i in range(len(part))} == {4}


def check_videos(root: Path, wanted: dict[str, np.ndarray[Any, Any]]) -> None:
    """Compare decoded images with the recorded ones: each is nearest to its own frame."""
    dataset = LeRobotDataset("local/rope", root=root, video_backend="pyav")
    images = rows_of(dataset)["observation.images.camera"].transpose(0, 2, 3, 1)
    recorded = wanted["rgb"] / 255.0
    own = np.abs(images - recorded).mean(axis=(1, 2, 3))
    print(f"images {images.shape}  mean difference {255 * own.max():.2f} of 255 in the worst of {len(images)}")
    assert 255 * own.max() < 4
    for i in range(1, len(images)):
        assert own[i] < np.abs(images[i] - recorded[i - 1]).mean(), f"frame {i} is not the one before it"
    assert dataset.meta.stats["observation.images.camera"]["mean"].shape == (3, 1, 1)
    assert np.allclose(
        dataset.meta.stats["observation.images.camera"]["mean"].ravel(), recorded.mean(axis=(0, 1, 2)), atol=0.01
    )


def check_training(root: Path) -> None:
    """Train ACT on the shapes for some steps."""
    meta = LeRobotDataset("local/rope", root=root).meta
    features = dataset_to_policy_features(meta.features)
    config = ACTConfig(
        input_features={name: each for name, each in features.items() if each.type is not FeatureType.ACTION},
        output_features={name: each for name, each in features.items() if each.type is FeatureType.ACTION},
        chunk_size=HORIZON,
        n_action_steps=HORIZON,
        dim_model=64,
        n_heads=4,
        dim_feedforward=128,
        n_encoder_layers=1,
        device="cpu",
        push_to_hub=False,
    )
    dataset = LeRobotDataset(
        "local/rope", root=root, delta_timestamps={"action": [i / meta.fps for i in range(HORIZON)]}
    )
    policy = make_policy(config, ds_meta=meta)
    before, _ = make_pre_post_processors(config, dataset_stats=meta.stats)
    steps = torch.optim.Adam(policy.parameters(), 1e-3)
    losses = []
    for _ in range(4):
        for batch in torch.utils.data.DataLoader(dataset, batch_size=16, shuffle=True):
            loss, _ = policy.forward(before(batch))
            steps.zero_grad()
            loss.backward()
            steps.step()
            losses.append(float(loss.detach()))
    print(f"ACT trains: loss {losses[0]:.2f} -> {losses[-1]:.2f}")
    assert np.isfinite(losses).all()
    assert losses[-1] < losses[0]


if __name__ == "__main__":
    made = Path(sys.argv[1])
    known = dict(np.load(made / "expected.npz"))
    print(f"lerobot {lerobot.__version__}, torch {torch.__version__}")
    check_rows(made / "plain", known)
    check_videos(made / "videos", known)
    check_training(made / "plain")
