"""Sample clouds with a known shape: ropes, rings, bent sheets and a moving rope.

All are about a metre in front of a camera at the origin (x right, y down, z forward).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from shape_obs.bench.scenes import resample, times
from tests.scenes.flat_objects import rolled

Array = npt.NDArray[np.float64]
Side = Literal["all", "front"]

NOISE: Final = 0.003  # metres, standard deviation in each direction
_COUNT: Final = 6000  # points
_STEP: Final = 0.002
_ORDERS: Final = np.arange(1, 4)  # of the harmonics of a rope's heading
# In metres: the smallest distance between strands, whose clouds must not touch; the distance along the curve beyond
# which points belong to different strands; and the radius of the tightest bend.
_CLEAR: Final = 0.06
_ALONG: Final = 0.12
_BEND: Final = 0.05
_TRIES: Final = 2000


@dataclass(frozen=True)
class RopeCloud:
    """A cloud of a rope."""

    points: Array  # (M, 3) metres, unordered
    curve: Array  # the axis from tip to tip, (P, 3) metres; that of a ring is closed without repeating the first point
    radius: float  # radius in metres


@dataclass(frozen=True)
class SheetCloud:
    """A cloud of a bent sheet."""

    points: Array  # (M, 3) metres, unordered
    size: tuple[float, float]  # width and height of the flat sheet in metres
    bend: float  # turn from one side to the other in radians
    axis: float  # direction of the bend's axis in the flat sheet in radians
    place: Array  # rotation and translation of the bent sheet, (3, 4)

    def at(self, share: Array) -> Array:
        """Return points at shares of width (left to right) and height (top to bottom): (N, 2) -> (N, 3) metres."""
        way, flat = np.array([-np.sin(self.axis), np.cos(self.axis)]), (share - 0.5) * self.size
        radius = float(np.abs(way) @ self.size) / max(abs(self.bend), 1e-9)
        halves = [rolled(flat, side * way, 0.0, radius, np.pi) for side in (1, -1)]
        space = np.where((flat @ way > 0)[:, None], *halves) * (1, 1, -np.sign(self.bend))
        return space @ self.place[:, :3].T + self.place[:, 3]

    def lattice(self, rows: int, cols: int) -> Array:
        """Return a lattice up to the border, (rows*cols, 3) metres, row by row from the top left."""
        v, u = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, cols), indexing="ij")
        return self.at(np.stack([u.ravel(), v.ravel()], axis=1))


def rope_cloud(
    rng: np.random.Generator, *, count: int = _COUNT, noise: float = NOISE, holes: int = 3, side: Side = "all"
) -> RopeCloud:
    """Sample a rope of 0.4 to 1.2 m and 4 to 8 mm radius from all sides or from the origin, with holes and speckle."""
    radius = float(rng.uniform(0.004, 0.008))
    for _ in range(_TRIES):
        curve = _placed(_heading_curve(rng.uniform(0.4, 1.2), _amplitudes(rng)), rng)
        if _is_clear(curve):
            return RopeCloud(_without(rng, _tube(rng, curve, radius, count, noise, side), curve, holes), curve, radius)
    raise RuntimeError("no rope found that keeps clear of itself.")


def ring_cloud(rng: np.random.Generator, *, count: int = _COUNT, holes: int = 0) -> RopeCloud:
    """Sample a closed rope of 0.09 to 0.2 m radius, bent out of its plane."""
    radius = float(rng.uniform(0.004, 0.008))
    phase = np.arange(0, 2 * np.pi, 0.005)
    swing = sum(rng.normal(0, 0.12 / k) * np.cos(k * phase + rng.uniform(0, 2 * np.pi)) for k in (2, 3))
    height = sum(rng.normal(0, 0.2 / k) * np.cos(k * phase + rng.uniform(0, 2 * np.pi)) for k in (1, 2))
    flat = np.stack([np.cos(phase), np.sin(phase), height], axis=1) * (1 + np.asarray(swing))[:, None]
    curve = _placed(flat * rng.uniform(0.09, 0.2), rng, turn=np.pi / 4)
    closed = np.concatenate([curve, curve[:1]])
    return RopeCloud(_without(rng, _tube(rng, closed, radius, count), closed, holes), curve, radius)


def sheet_cloud(rng: np.random.Generator, *, count: int = _COUNT, bend: float = 1.2) -> SheetCloud:
    """Sample a sheet of 0.2 to 0.4 m, bent by at most ``bend`` radians, with its front towards the camera."""
    size = (float(rng.uniform(0.3, 0.4)), float(rng.uniform(0.2, 0.28)))
    turn = _rotation(rng.uniform(-np.pi / 5, np.pi / 5, 3) * (1, 1, 0.3))
    place = np.column_stack([turn, rng.uniform(-0.1, 0.1, 3) + (0, 0, 0.9)])
    sheet = SheetCloud(np.zeros((0, 3)), size, float(rng.uniform(-bend, bend)), float(rng.uniform(0, np.pi)), place)
    points = sheet.at(rng.uniform(size=(count, 2)))
    return SheetCloud(points + rng.normal(0, NOISE, points.shape), size, sheet.bend, sheet.axis, place)


def moving_rope_cloud(rng: np.random.Generator, speed: float, frames: int = 180) -> Iterator[RopeCloud]:
    """Sample a rope of 0.7 m that turns, bends and wanders; its fastest point moves ``speed`` metres per frame."""
    base, swing = _amplitudes(rng), _amplitudes(rng)
    rates, turn = rng.uniform(0.4, 1.0, swing.shape), rng.uniform(-0.3, 0.3, 3)
    start, phases = rng.uniform(0, 2 * np.pi, 3), rng.uniform(0, 2 * np.pi, 3)

    def curve_at(time: float) -> Array:
        curve = _heading_curve(0.7, 0.6 * base + 0.5 * swing * np.sin(rates * time + phases[0]))
        middle = np.array([0, 0, 0.9]) + 0.12 * np.sin([0.7 * time, 0.5 * time, 0.6 * time] + phases)
        return (curve - curve.mean(axis=0)) @ _rotation(start + turn * time).T + middle

    for time in times(curve_at, speed, frames):
        curve = curve_at(time)
        yield RopeCloud(_without(rng, _tube(rng, curve, 0.006), curve, 2), curve, 0.006)


def _amplitudes(rng: np.random.Generator) -> Array:
    """Draw amplitudes of yaw and pitch, (2, harmonics, 2): cosine and sine."""
    return rng.normal(0, 1, (2, len(_ORDERS), 2)) * 0.9 / _ORDERS[None, :, None]


def _heading_curve(length: float, amplitudes: Array) -> Array:
    """Return a curve whose heading swings along it, ``(P, 3)`` metres at even steps."""
    count = max(round(length / _STEP), 2)
    order = np.pi * _ORDERS[:, None] * np.linspace(0, 1, count)
    yaw, pitch = np.einsum("akp,kpn->an", amplitudes, np.stack([np.cos(order), np.sin(order)], axis=1))
    flat = np.cos(0.6 * pitch)
    heading = np.stack([np.cos(yaw) * flat, np.sin(yaw) * flat, np.sin(0.6 * pitch)], axis=1)
    return np.concatenate([np.zeros((1, 3)), np.cumsum(heading[:-1], axis=0)]) * (length / (count - 1))


def _is_clear(curve: Array) -> bool:
    """Return whether strands keep their distance and no bend is too tight."""
    pairs = KDTree(curve).query_pairs(_CLEAR, output_type="ndarray")
    bend = np.linalg.norm(np.diff(curve, n=2, axis=0), axis=1).max() / _STEP**2
    return not np.any((pairs[:, 1] - pairs[:, 0]) * _STEP > _ALONG) and bool(bend < 1 / _BEND)


def _placed(curve: Array, rng: np.random.Generator, turn: float = np.pi) -> Array:
    """Turn a curve at random and move it about a metre in front of the camera."""
    turned = (curve - curve.mean(axis=0)) @ _rotation(rng.uniform(-turn, turn, 3)).T
    return turned + rng.uniform(-0.1, 0.1, 3) + (0, 0, 1)


def _rotation(angles: Array) -> Array:
    """Return the rotation by angles about x, y and z, in radians."""
    return Rotation.from_euler("xyz", angles).as_matrix()


def _tube(
    rng: np.random.Generator, curve: Array, radius: float, count: int = _COUNT, noise: float = NOISE, side: Side = "all"
) -> Array:
    """Sample a tube's surface: all of it, or the half that is visible from the origin, evenly in the image."""
    fine = resample(curve, _STEP / 4)
    at = rng.integers(len(fine), size=count)
    tangent = np.gradient(fine, axis=0)[at]
    across = np.cross(fine[at], tangent)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    towards = np.cross(across, tangent)
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    towards *= -np.sign(np.sum(towards * fine[at], axis=1))[:, None]
    angle = rng.uniform(0, 2 * np.pi, count) if side == "all" else np.arccos(rng.uniform(-1, 1, count))
    offset = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * towards
    return fine[at] + radius * offset + rng.normal(0, noise, (count, 3))


def _without(rng: np.random.Generator, points: Array, curve: Array, holes: int) -> Array:
    """Remove stretches of 1 to 5 cm, at least 4 cm from the tips, and 20 specks of 4 to 8 mm radius."""
    fine = resample(curve, _STEP)
    arc = KDTree(fine).query(points)[1] * _STEP
    keep = np.ones(len(points), bool)
    for _ in range(holes):
        size = rng.uniform(0.01, 0.05)
        start = rng.uniform(0.04, max(len(fine) * _STEP - 0.04 - size, 0.05))
        keep &= (arc < start) | (arc > start + size)
    for place in points[rng.integers(len(points), size=20 if holes else 0)]:
        keep &= np.linalg.norm(points - place, axis=1) > rng.uniform(0.004, 0.008)
    return points[keep]
