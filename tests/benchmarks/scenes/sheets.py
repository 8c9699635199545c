"""Draw cloths whose every material point is known, at rest and moving.

The cloths are independent of the library's method: smooth fields bend a regular lattice, without a Coons patch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

from shape_obs.configurations.base import Ends
from shape_obs.geometry.lattice import sample_lattice
from tests.benchmarks.scenes.ropes import SIZE, blank, covered, subpixel
from tests.benchmarks.scenes.ropes import rotation as turned_by

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.uint8]

_FINE: Final = 65  # points along each side of the known lattice
_MARGIN: Final = 12.0
_MOVING: Final = 0.8  # size of a moving cloth relative to one at rest, so that there is room to move
# Cloth bends and shears in the image plane and hardly stretches: the standard deviation by which sides bend, as a share
# of the short side; points slide along their side by a fifth of it.
_BEND: Final = 0.035
_SLIDE: Final = 0.2
_CORNER_TURN: Final = 55.0  # smallest turn of the outline at a corner in degrees


@dataclass(frozen=True)
class Sheet:
    """A drawn cloth.

    Args:
        points: The material lattice up to the border, (65, 65, 2) pixels: rows from top to bottom, columns from left to
            right in the cloth's frame.
        mask: ``(H, W)`` uint8, 0 or 255.
    """

    points: Array
    mask: Mask

    def lattice(self, rows: int, cols: int, ends: Ends) -> Array:
        """Return the true positions of a lattice's points in the cloth's frame, (rows, cols, D)."""
        index, fine = np.arange(float(_FINE)), np.ascontiguousarray(self.points, dtype=np.float64)
        return sample_lattice(fine, index, index, rows, cols, ends == "centers").reshape(rows, cols, -1)


def places(count: int, ends: Ends) -> Array:
    """Return positions from 0 to 1, (count,): the centres of equal pieces, or from border to border."""
    return np.linspace(0, 1, count) if ends == "tips" else (np.arange(count) + 0.5) / count


def random_sheet(
    rng: np.random.Generator,
    aspect: float,
    degrees: float,
    *,
    tilt: float = 0.0,
    bend: float = _BEND,
) -> Sheet:
    """Draw a cloth with bent sides and corners that are not right angles.

    Args:
        rng: Draws the deformation.
        aspect: Width over height in the cloth's frame.
        degrees: Rotation, clockwise as seen.
        tilt: Perspective: how much nearer the near edge is than the far one, as a share.
        bend: Standard deviation of each bending mode, in short sides.
    """
    for _ in range(200):
        flat = regular(aspect)
        field = _field(rng, flat, bend)
        points = _projected(flat + field(0.0), tilt, rng.uniform(0, 2 * np.pi)) @ rotation(degrees).T
        if is_cloth(points):
            return draw_sheet(_fitted(points, rng))
    raise RuntimeError(f"no sheet of aspect {aspect} was found that neither folds nor loses its corners.")


def turning_sheet(rng: np.random.Generator, aspect: float, step: float = 1.0) -> Iterator[Sheet]:
    """Draw a bent cloth that turns once around on the spot by ``step`` degrees per frame."""
    points = random_sheet(rng, aspect, 0.0).points
    points = points - points.mean(axis=(0, 1))
    reach = np.linalg.norm(points, axis=-1).max()
    points *= min((min(SIZE) / 2 - _MARGIN) / reach, 1.0)
    for degrees in np.arange(0.0, 360.0 + step / 2, step):
        yield draw_sheet(points @ rotation(degrees).T + np.array([SIZE[1] - 1, SIZE[0] - 1]) / 2)


def moving_sheet(rng: np.random.Generator, speed: float, frames: int = 180, *, aspect: float = 1.5) -> Iterator[Sheet]:
    """Draw a cloth that wanders, turns and bends; its fastest point moves ``speed`` pixels per frame."""
    flat = regular(aspect) * _MOVING
    while True:
        field, turn = _field(rng, flat, _BEND), rng.uniform(0.15, 0.4) * rng.choice([-1, 1])
        start = rng.uniform(0, 2 * np.pi, 3)
        if all(is_cloth(flat + field(time)) for time in np.linspace(0, 60, 121)):
            break
    reach = np.linalg.norm(flat, axis=-1).max() * 1.15
    room = np.maximum(np.array([SIZE[1], SIZE[0]]) / 2 - reach - _MARGIN, 10.0)

    def at(time: float) -> Array:
        middle = np.array([SIZE[1], SIZE[0]]) / 2 + room * np.sin([0.7 * time + start[1], 0.5 * time + start[2]])
        return (flat + field(time)) @ rotation(np.degrees(start[0] + turn * time)).T + middle

    time = 0.0
    for _ in range(frames):
        yield draw_sheet(at(time))
        time = _after(at, time, speed)


def draw_sheet(points: Array, size: tuple[int, int] = SIZE) -> Sheet:
    """Draw the cloth with a given lattice, (65, 65, 2) pixels."""
    border = border_of(points)
    low = np.clip(np.floor(border.min(axis=0)).astype(int) - 1, 0, (size[1] - 1, size[0] - 1))
    high = np.clip(np.ceil(border.max(axis=0)).astype(int) + 2, low + 1, (size[1], size[0]))
    width, height = (high - low).tolist()
    canvas, mask = blank((height, width)), np.zeros(size, np.uint8)
    cv2.fillPoly(canvas, [subpixel(border - low)], (255,), shift=8)
    mask[low[1] : high[1], low[0] : high[0]] = covered(canvas)
    return Sheet(points, mask)


def border_of(points: Array) -> Array:
    """Return the border of a cloth from its top left corner, ``(P, 2)``, clockwise in the cloth's frame."""
    return np.concatenate([points[0, :-1], points[:-1, -1], points[-1, :0:-1], points[:0:-1, 0]])


def noisy(mask: Mask, rng: np.random.Generator, sigma: float = 0.15) -> Mask:
    """Return the mask that a threshold cuts from a blurred, noisy image; only the border changes."""
    soft = cv2.GaussianBlur(mask, (0, 0), 1.2) / 255.0
    return np.where(soft + rng.normal(0, sigma, mask.shape) > 0.5, np.uint8(255), np.uint8(0))


def regular(aspect: float) -> Array:
    """Return a flat cloth about the origin whose diagonal fits an image at any angle, (65, 65, 2) pixels."""
    width = 330.0 * aspect / np.hypot(1.0, aspect)
    across, down = np.linspace(-0.5, 0.5, _FINE) * width, np.linspace(-0.5, 0.5, _FINE) * width / aspect
    return np.stack(np.meshgrid(across, down), axis=-1)


def rotation(degrees: float) -> Array:
    """Return a rotation that is clockwise as seen, since v points down, ``(2, 2)``."""
    return turned_by(np.radians(degrees))


def is_cloth(points: Array) -> bool:
    """Return whether a lattice has no folds and four corners."""
    right, down = np.gradient(points, axis=1), np.gradient(points, axis=0)
    area = right[..., 0] * down[..., 1] - right[..., 1] * down[..., 0]
    lengths = np.linalg.norm(right, axis=-1) * np.linalg.norm(down, axis=-1)
    corners = (area / lengths)[[0, 0, -1, -1], [0, -1, 0, -1]]
    return bool(area.min() > 0.5 * area.mean() and corners.min() > np.sin(np.radians(_CORNER_TURN)))


def _field(rng: np.random.Generator, flat: Array, bend: float) -> Callable[[float], Array]:
    """Return a smooth displacement field that swings with time: time -> (65, 65, 2) pixels."""
    width, height = np.ptp(flat[..., 0]), np.ptp(flat[..., 1])
    u, v = flat[..., 0] / width + 0.5, flat[..., 1] / height + 0.5
    modes = []
    for across in range(4):
        for down in range(4):
            if 1 <= across + down <= 3:
                wave = np.cos(np.pi * across * u) * np.cos(np.pi * down * v)
                # A displacement along the direction of the wave would stretch the cloth.
                shares = np.array([1.0 if across == 0 else _SLIDE, 1.0 if down == 0 else _SLIDE])
                amplitude = rng.normal(0, bend, 2) * shares * min(width, height) / (across + down)
                modes.append((wave[..., None] * amplitude, rng.uniform(0, 2 * np.pi), rng.uniform(0.3, 0.9)))

    def at(time: float) -> Array:
        return np.sum([wave * 2**0.5 * np.cos(rate * time + phase) for wave, phase, rate in modes], axis=0)

    return at


def _projected(points: Array, tilt: float, direction: float) -> Array:
    """Project points that are tilted towards ``direction``, in radians."""
    along = points @ np.array([np.cos(direction), np.sin(direction)])
    depth = 1 - tilt * along / np.ptp(along)
    return points / depth[..., None]


def _fitted(points: Array, rng: np.random.Generator) -> Array:
    """Move points to a random position inside the image."""
    low, high = points.min(axis=(0, 1)), points.max(axis=(0, 1))
    room = np.array([SIZE[1], SIZE[0]]) - 2 * _MARGIN - (high - low)
    return points - low + _MARGIN + np.maximum(room, 0) * rng.uniform(size=2)


def _after(at: Callable[[float], Array], time: float, speed: float) -> float:
    """Return the next time at which some point has moved ``speed`` pixels."""
    before = at(time)

    def beyond(step: float) -> float:
        return float(np.linalg.norm(at(time + step) - before, axis=-1).max() - speed)

    high = 0.02
    while beyond(high) < 0:
        high *= 1.5
    return time + float(brentq(beyond, 0.0, high, xtol=1e-4))  # type: ignore[arg-type]
