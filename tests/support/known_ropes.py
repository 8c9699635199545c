"""Ropes whose points are known, and shapes of them."""

from __future__ import annotations

from typing import Any

import numpy as np

from shape_obs import CameraModel, Shape
from shape_obs.features import PointDistribution
from shape_obs.geometry.topology import Chain

N = 20
WORKSPACE = ((-0.5, -0.5, -0.1), (0.5, 0.5, 0.3))
EVERYWHERE = np.ones(N)


def ropes(count: int, seed: int = 0, heading: float = 0.3) -> np.ndarray:
    """Return inextensible curves of 0.4 m on a table with two random bends, places and headings, (F, N, 3)."""
    draw = np.random.default_rng(seed)
    s = (np.arange(200) + 0.5) / 200
    bends = draw.uniform(-1, 1, (count, 2)) * (1.5, 0.8)
    angle = (
        draw.uniform(-heading, heading, (count, 1)) + bends[:, :1] * (s - 0.5) + bends[:, 1:] * np.cos(2 * np.pi * s)
    )
    path = np.cumsum(np.stack([np.cos(angle), np.sin(angle)], axis=2), axis=1) * 0.4 / 200
    flat = path[:, np.linspace(0, 199, N).astype(int)]
    flat += draw.uniform(-0.05, 0.05, (count, 1, 2)) - flat.mean(axis=1, keepdims=True)
    return np.concatenate([flat, np.full((count, N, 1), 0.01)], axis=2)


def fit(points: np.ndarray | None = None, components: int = 4, **rest: Any) -> PointDistribution:
    given = {"layout": Chain(N), "frame": "base", **rest}
    return PointDistribution.fit(ropes(200) if points is None else points, components, **given)


def seen(points: np.ndarray, camera: CameraModel, valid: Any = True) -> Shape:
    """Return a shape of base-frame points; those that are not valid are NaN."""
    valid = np.full(N, True) & valid
    at = np.where(valid[:, None], camera.from_base(points), np.nan).astype(np.float32)
    return Shape("rope", camera.intrinsics.project(at).astype(np.float32), at, valid, valid, Chain(N))


def off(a: np.ndarray, b: np.ndarray) -> float:
    """Return the mean distance in millimetres."""
    return 1e3 * float(np.linalg.norm(a - b, axis=-1).mean())


#: By origin, and whether aligned.
MODELS = {
    (origin, aligned): fit(
        ropes(200) - (ropes(200).mean(axis=1, keepdims=True) if origin else 0), 6, origin=origin, aligned=aligned
    )
    for origin in (None, "centroid")
    for aligned in (False, True)
}
