"""Draw blobs and garments with a known outline."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal, get_args

import numpy as np
import numpy.typing as npt

from shape_obs.bench.scenes import SIZE, Blob, draw_blob, random_waves, rotation, wavy_circle
from shape_obs.utils.documents import read_json
from tests.scenes.ropes import arcs, normals

Array = npt.NDArray[np.float64]
Kind = Literal["smooth", "c", "horseshoe", "star"]
KINDS: Final[tuple[Kind, ...]] = get_args(Kind)
_MARGIN: Final = 8.0


@dataclass(frozen=True)
class Garment(Blob):
    """A drawn garment."""

    corners: dict[str, Array] = field(default_factory=dict)  # its visible annotated keypoints: name -> (u, v)


def garments(path: str | Path, size: tuple[int, int] = SIZE) -> Iterator[Garment]:
    """Draw annotated garment outlines into images of ``size`` ``(H, W)``.

    Args:
        path: A JSON list of ``{kind, width, height, polygon: [[u, v], ...], keypoints: {name: [u, v, hidden]}}``.
        size: Size of the image in pixels; the annotated photo is shrunk to fit.
    """
    for item in read_json(path, "outlines"):
        scale = min(size[1] / item["width"], size[0] / item["height"])
        blob = draw_blob((np.array(item["polygon"]) + 0.5) * scale - 0.5, size=size)
        seen = {name: np.array([u, v]) for name, (u, v, hidden) in item["keypoints"].items() if not hidden}
        corners = {name: (place + 0.5) * scale - 0.5 for name, place in seen.items()}
        yield Garment(blob.outline, blob.mask, item["kind"], corners=corners)


def random_blob(rng: np.random.Generator, kind: Kind = "smooth", size: tuple[int, int] = SIZE) -> Blob:
    """Draw a blob with rounded corners inside an image of ``size`` ``(H, W)``."""
    for _ in range(2000):
        outline = _formed(rng, kind) @ rotation(rng.uniform(0, 2 * np.pi)).T
        low, high = outline.min(axis=0), outline.max(axis=0)
        room = np.array([size[1], size[0]]) - 2 * _MARGIN - (high - low)
        if np.all(room >= 0):
            return draw_blob(outline - low + _MARGIN + room * rng.uniform(size=2), size=size, kind=kind)
    raise RuntimeError(f"no {kind} blob found that fits {size[1]} x {size[0]} pixels.")


def _formed(rng: np.random.Generator, kind: Kind) -> Array:
    """Return the outline of a blob of some kind, ``(P, 2)`` pixels."""
    if kind == "smooth":
        return rng.uniform(50, 150) * wavy_circle(random_waves(rng, rng.uniform(0.05, 0.25)))
    if kind == "star":
        tips, depth, angle = rng.integers(3, 8), rng.uniform(0.15, 0.35), 2 * np.pi * np.arange(1440) / 1440
        return (rng.uniform(90, 150) * (1 + depth * np.cos(tips * angle)))[:, None] * np.stack(
            [np.cos(angle), np.sin(angle)], axis=1
        )
    if kind == "c":
        radius, turn = rng.uniform(70, 130), 2 * np.pi - rng.uniform(0.5, 2.0)
        return _thick(arcs((radius * turn, turn)), radius * rng.uniform(0.2, 0.5))
    radius, leg = rng.uniform(50, 100), rng.uniform(60, 160)
    line = arcs((leg, 0.0), (np.pi * radius, np.pi), (leg * rng.uniform(0.6, 1), 0.0))
    return _thick(line, radius * rng.uniform(0.2, 0.7))


def _thick(line: Array, width: float) -> Array:
    """Return the outline of a ribbon with round ends about a line of ``(P, 2)``."""
    side = width / 2 * normals(line)
    ahead = np.stack([side[:, 1], -side[:, 0]], axis=1)
    half = np.linspace(0, np.pi, 60)[1:-1, None]
    last = line[-1] + np.cos(half) * side[-1] + np.sin(half) * ahead[-1]
    first = line[0] - np.cos(half) * side[0] - np.sin(half) * ahead[0]
    return np.concatenate([line + side, last, (line - side)[::-1], first])
