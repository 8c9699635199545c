"""Random inputs for a detector, most of them degenerate: masks, depth images, cameras, clouds, configurations."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.scenes import draw_rope
from shape_obs.camera import CameraModel, Intrinsics

Array = npt.NDArray[np.float64]
Size = tuple[int, int]
T = TypeVar("T")

_MASKS: Final = (
    "empty", "full", "pixel", "pixels", "row", "column", "diagonal", "stripes", "checkerboard", "noise", "frame",
    "edge", "box", "disc", "ring", "rope", "rope", "rope", "strip", "strip", "cross", "sheet", "sheet",
)  # fmt: skip
#: Kinds of masks and clouds in which a configuration finds its shape.
HELD: Final = {"centerline": ("rope",), "contour": ("disc", "ring", "sheet"), "surface": ("sheet",)}
_DEPTHS: Final = (
    "none", "none", "zero", "nan", "infinite", "negative", "random", "noise", "flat", "flat", "flat", "flat", "one",
    "farthest", "tiny", "absurd", "tilted", "tilted", "holes", "holes", "mixed",
)  # fmt: skip
_LENSES: Final = ("plain", "plain", "plain", "short", "long", "aside", "unequal", "distorted", "distorted", "wild")
_CLOUDS: Final = (
    "none", "point", "same", "line", "plane", "ball", "rope", "rope", "ring", "sheet", "two", "missing", "far", "thin",
)  # fmt: skip


def pick(rng: np.random.Generator, options: tuple[T, ...]) -> T:
    """Return one of the options."""
    return options[int(rng.integers(len(options)))]


def image_size(rng: np.random.Generator) -> Size:
    """Return (H, W): 1 x 1 up to 240 x 320 pixels, small sizes more often."""
    low, high = pick(rng, ((1, 4), (1, 17), (8, 40), (30, 90), (60, 120), (60, 120), (60, 120), (120, 241)))
    height, width = int(rng.integers(low, high)), int(rng.integers(low, high * 4 // 3 + 1))
    return (height, width) if rng.random() < 0.9 else pick(rng, ((1, 4 * width), (4 * height, 1)))


def mask(rng: np.random.Generator, size: Size, kinds: tuple[str, ...] = _MASKS) -> npt.NDArray[Any]:
    """Return a (H,W) mask of one of the kinds: bool, or uint8 with 0, 1 or any other values."""
    height, width = size
    out = np.zeros(size, np.uint8)
    thick, at = int(rng.integers(1, 3)), (int(rng.integers(height)), int(rng.integers(width)))
    kind = pick(rng, kinds)
    if kind == "full":
        out[:] = 1
    elif kind == "pixel":
        out[at] = 1
    elif kind == "pixels":
        out.ravel()[rng.integers(out.size, size=int(rng.integers(1, 30)))] = 1
    elif kind == "row":
        out[at[0] : at[0] + thick] = 1
    elif kind == "column":
        out[:, at[1] : at[1] + thick] = 1
    elif kind == "diagonal":
        cv2.line(out, (0, 0), (width - 1, height - 1), 1, thick)
    elif kind == "stripes":
        out[(np.arange(height) // thick) % 2 == 0] = 1
        out = out if rng.random() < 0.5 else np.ascontiguousarray(np.resize(out.T, size))
    elif kind == "checkerboard":
        edge = int(rng.integers(1, 9))
        out[:] = (np.arange(height)[:, None] // edge + np.arange(width) // edge) % 2
    elif kind == "noise":
        grain, share = int(rng.integers(1, 9)), rng.uniform(0.02, 0.98)
        coarse = rng.random((-(-height // grain), -(-width // grain))) < share
        out = np.kron(coarse, np.ones((grain, grain), np.uint8))[:height, :width].astype(np.uint8)
    elif kind == "frame":
        out[:thick], out[-thick:], out[:, :thick], out[:, -thick:] = 1, 1, 1, 1
    elif kind == "edge":
        out[: int(rng.integers(1, height + 1))] = 1
    elif kind == "box":
        out[at[0] : at[0] + int(rng.integers(1, 60)), at[1] : at[1] + int(rng.integers(1, 60))] = 1
    elif kind in ("disc", "ring"):
        radius = int(rng.integers(1, max(height, width) + 1))
        cv2.circle(out, at[::-1], radius, 1, -1 if kind == "disc" else thick)
    elif kind == "rope":
        out = _rope(rng, size)
    elif kind == "strip":  # thin and straight
        length = int(rng.integers(2, max(height, width) + 2))
        out[at[0] : at[0] + thick, at[1] : at[1] + length] = 1
        out = out if rng.random() < 0.5 else np.ascontiguousarray(np.resize(out.T, size))
    elif kind == "cross":
        out[at[0] : at[0] + 3 * thick], out[:, at[1] : at[1] + 3 * thick] = 1, 1
    elif kind == "sheet":
        out = _sheet(rng, size)
    if rng.random() < 0.1:
        out[rng.random(size) < 0.03] ^= 1
    values = pick(rng, ("bool", "one", "full", "any"))
    if values == "bool":
        return out.astype(bool)
    return out * {"one": 1, "full": 255, "any": int(rng.integers(1, 256))}[values]


def depth(rng: np.random.Generator, size: Size, *, needed: bool = False) -> npt.NDArray[Any] | None:
    """Return a (H,W) depth image: uint16 millimetres, floating metres, or (unless ``needed``) None."""
    kind = pick(rng, _DEPTHS[2:] if needed else _DEPTHS)
    if kind == "none":
        return None
    out = np.full(size, rng.uniform(0.2, 3.0))
    if kind in ("zero", "one"):
        out[:] = 0.0
        out[tuple(rng.integers(size))] = 0.7 if kind == "one" else 0.0
    elif kind in ("nan", "infinite", "negative"):
        out[:] = {"nan": np.nan, "infinite": np.inf, "negative": -1.0}[kind]
    elif kind == "random":
        out = rng.uniform(0, 3, size)
    elif kind == "noise":
        out += rng.normal(0, pick(rng, (1e-3, 0.05)), size)
    elif kind == "farthest":
        out[:] = 65.535
    elif kind == "tiny":
        out[:] = pick(rng, (1e-3, 1e-30, 1e-300))
    elif kind == "absurd":
        out[:] = pick(rng, (9e5, 1e12, 1e300))
    elif kind == "tilted":
        out += np.linspace(-0.15, 0.15, size[1])
    elif kind == "holes":
        out[rng.random(size) < rng.uniform(0, 1)] = pick(rng, (0.0, np.nan))
    elif kind == "mixed":
        out = rng.choice([0.0, np.nan, np.inf, -np.inf, -1.0, 0.7, 0.7, 1e-3, 1e5], size)
    dtype = pick(rng, ("uint16", "float16", "float32", "float32", "float64"))
    if dtype == "uint16":
        return np.clip(np.nan_to_num(out, nan=0.0, posinf=65.535, neginf=0.0) * 1000, 0, 65535).astype(np.uint16)
    limit = float(np.finfo(dtype).max)
    return np.clip(out, -limit, limit).astype(dtype) if np.isfinite(out).all() else _narrowed(out, dtype)


def _narrowed(values: Array, dtype: str) -> npt.NDArray[Any]:
    limit = float(np.finfo(dtype).max)
    return np.where(np.isfinite(values), np.clip(values, -limit, limit), values).astype(dtype)


def camera(
    rng: np.random.Generator, size: Size, *, needed: bool = False, posed: bool = False
) -> CameraModel | Intrinsics | None:
    """Return intrinsics of any accepted kind, with or without a pose, or None; a pose if ``posed``."""
    if rng.random() < 0.15 and not needed:
        return None
    height, width = size
    fx = fy = float(max(size))
    cx, cy = (width - 1) / 2, (height - 1) / 2
    model, coeffs = "pinhole", (0.0,) * 5
    lens = pick(rng, _LENSES)
    if lens == "short":
        fx = fy = pick(rng, (1e-3, 0.1, 1.0))
    elif lens == "long":
        fx = fy = pick(rng, (1e6, 1e9))
    elif lens == "aside":
        cx, cy = float(rng.normal(0, 1e6)), float(rng.normal(0, 1e6))
    elif lens == "unequal":
        fx, fy = 1e-3, 1e6
    elif lens in ("distorted", "wild"):
        model = pick(rng, ("brown_conrady", "inverse_brown_conrady"))
        scale = pick(rng, (0.1, 1.0)) if lens == "distorted" else pick(rng, (100.0, 1e5))
        coeffs = tuple((rng.normal(0, scale, 5) * (1, 1, 0.1, 0.1, 1)).tolist())
    intrinsics = Intrinsics(width, height, fx, fy, cx, cy, model, coeffs)  # type: ignore[arg-type]
    if rng.random() < 0.4 and not posed:
        return intrinsics
    pose = np.eye(4)
    axis = rng.normal(size=3)
    pose[:3, :3] = cv2.Rodrigues(axis / np.linalg.norm(axis) * rng.uniform(0, np.pi))[0]
    pose[:3, 3] = rng.normal(size=3) * pick(rng, (0.0, 1.0, 1e6))
    return CameraModel(intrinsics, pose)


def cloud(rng: np.random.Generator, kinds: tuple[str, ...] = _CLOUDS) -> npt.NDArray[Any]:
    """Return (M,3) or (H,W,3) floating metres of one of the kinds."""
    count, kind = int(rng.integers(1, 800)), pick(rng, kinds)
    along, across = rng.uniform(0, 1, count), rng.uniform(-1, 1, count)
    points = rng.normal(size=(count, 3)) * 0.01 + (0, 0, 0.7)
    if kind == "none":
        points = points[:0]
    elif kind == "point":
        points = points[:1]
    elif kind == "same":
        points[:] = points[0]
    elif kind in ("line", "thin"):
        points = np.stack([along, 0 * along, 0 * along + 0.7], axis=1)
        points[:, 1] += 0.0 if kind == "line" else 1e-9 * across
    elif kind in ("plane", "sheet"):
        points = np.stack([along * 0.4, across * 0.15, 0.7 + 0.1 * along * (kind == "sheet")], axis=1)
    elif kind == "rope":
        points = np.stack([along, 0.2 * np.sin(5 * along), 0.7 + 0 * along], axis=1) + rng.normal(0, 0.004, (count, 3))
    elif kind == "ring":
        turn = 2 * np.pi * along
        points = np.stack([np.cos(turn), np.sin(turn), 3 + 0 * turn], axis=1) + rng.normal(0, 0.01, (count, 3))
    elif kind == "two":
        points[::2] += (pick(rng, (0.1, 100.0)), 0, 0)
    elif kind == "missing":
        points[rng.random(count) < 0.6] = pick(rng, (0.0, np.nan, np.inf))
    elif kind == "far":
        points *= pick(rng, (1e-12, 1e4, 9e5, 1e30))
    dtype = pick(rng, ("float16", "float32", "float64"))
    points = _narrowed(points, dtype)
    return points if rng.random() < 0.8 else points[None]


def configuration(rng: np.random.Generator, name: str) -> dict[str, Any]:
    """Return the mapping of a configuration."""
    kind = pick(rng, ("centerline", "contour", "surface"))
    spec: dict[str, Any] = {"kind": kind, "name": name}
    if kind == "surface":
        spec |= {"rows": pick(rng, (2, 2, 4, 9, 40)), "cols": pick(rng, (2, 3, 8, 40)), "epochs": pick(rng, (0, 0, 2))}
    else:
        spec["n"] = pick(rng, (2, 3, 20, 20, 50, 1000) if kind == "centerline" else (3, 4, 20, 32, 100, 1000))
    if kind != "contour":
        spec["ends"] = pick(rng, ("centers", "tips"))
    spec["lift"] = pick(rng, ("points", "points", "points", "cloud"))
    spec["spacing"] = pick(rng, ("px", "px", "px", "m"))
    spec["radius"] = pick(rng, (0.0, 0.0, 0.005, 10.0))
    anchors = ((0.0, 0.0), (1e9, -1e9), (0.0, 0.0, 0.7), (5e5, 0.0, 1e6), "hand", "hand")
    spec["anchor"] = pick(rng, anchors) if rng.random() < 0.3 else None
    return spec


def detector_options(rng: np.random.Generator) -> dict[str, Any]:
    """Return the other arguments of a ``ShapeDetector``; the segmentation accepts single pixels."""
    segmentation: Mapping[str, Any] = {
        "kind": "gray",
        "low": int(rng.integers(0, 256)),
        "open": pick(rng, (0, 0, 1, 3)),
        "close": pick(rng, (0, 0, 1, 4)),
        "min_area": pick(rng, (1, 1, 30)),
        "min_share": pick(rng, (0.0, 0.1)),
    }
    if rng.random() < 0.2:
        segmentation = {"kind": "depth", "near": 0.1, "far": 2.0, "min_area": 1}
    options = {
        "segmentation": segmentation,
        "order": pick(rng, ("tracked", "image")),
        "on_missing": pick(rng, ("hold", "hold", "truncate", "nan", "raise")),
        "on_invalid": pick(rng, ("nan", "interpolate", "hold")),
        "max_age": pick(rng, (0.0, 0.05, 0.5)),
        "dt": pick(rng, (1e-6, 1 / 30, 100.0)),
    }
    if rng.random() < 0.1:
        options["clustering"] = pick(rng, ("kmeans", "gmm", "fcm", "kohonen"))
    return options


def stamp(rng: np.random.Generator, before: float) -> float | None:
    """Return the next stamp: later, equal, earlier, far off, or None."""
    later, far = (before + 0.03, before + 1e-12, before + 5e-324), (before + 1e9, before - 1e9, 0.0, 1e300)
    return pick(rng, (None, None, later[0], later[0], *later, before, before - 1.0, *far))


def _rope(rng: np.random.Generator, size: Size) -> npt.NDArray[np.uint8]:
    height, width = size
    u = np.linspace(rng.uniform(-0.1, 0.3), rng.uniform(0.5, 1.1), 200) * width
    swing = rng.uniform(0, 0.3) * height
    v = rng.uniform(0.3, 0.7) * height + swing * np.sin(u * rng.uniform(1, 9) / max(width, 1))
    out = draw_rope(np.stack([u, v], axis=1), float(rng.uniform(1, 12)), size=size).mask.copy()
    if rng.random() < 0.3:  # something lies over it
        out[:, int(width * rng.uniform(0, 1)) :][:, : int(rng.integers(1, 40))] = 0
    return out


def _sheet(rng: np.random.Generator, size: Size) -> npt.NDArray[np.uint8]:
    height, width = size
    corners = np.array([[0.2, 0.2], [0.8, 0.2], [0.8, 0.8], [0.2, 0.8]]) + rng.normal(0, 0.04, (4, 2))
    out = np.zeros(size, np.uint8)
    cv2.fillPoly(out, [np.round(corners * (width, height)).astype(np.int32)], 1)
    return out
