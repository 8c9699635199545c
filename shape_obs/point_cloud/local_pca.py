"""The measures of a cloud as a rope, by principal components of its neighbourhoods."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled

Array = npt.NDArray[np.float64]

# So many points stand for all, and neighbourhoods of so many are looked at: both estimates vary by a few percent.
_POINTS: Final = 1500
_SEEDS: Final = 32
# Neighbourhoods grow from a 64th of the cloud by steps of sqrt 2 until they are this many times longer than thick.
_RADII: Final = 2.0 ** (np.arange(13) / 2) / 64  # of the extent
_ELONGATED: Final = 2.2
_CROSSING: Final = 3.0  # of the median spread: no neighbourhood counts as more
_FEWEST: Final = 12  # points in a neighbourhood; the shape of fewer is chance


class Ribbon(NamedTuple):
    """The measures of a cloud as a rope.

    Args:
        width: Metres; sqrt(12) times the rms spread across the local axis in the direction in which it is larger: a
            flat ribbon's width. The short side of what is no rope.
        spread_width: Metres; the same for the spread in both directions across.
        length: Metres.
    """

    width: float
    spread_width: float
    length: float


def measure(points: Array) -> Ribbon:
    """Measure a cloud by local PCA at the smallest scale at which its neighbourhoods are elongated.

    A neighbourhood smaller than the rope is thick is a ball; a much larger one sees the rope's bends. Length is the
    mean, over points drawn from all, of the length of rope in a neighbourhood for each point in it, times the points.

    Args:
        points: ``(M, 3)`` metres.
    """
    draw = np.random.default_rng(0)
    some = points if len(points) <= _POINTS else points[draw.integers(len(points), size=_POINTS)]
    if len(some) < _FEWEST:
        return Ribbon(0.0, 0.0, 0.0)
    some = some - some.mean(axis=0)
    seeds, radii = some[draw.integers(len(some), size=_SEEDS)], _RADII * float(np.linalg.norm(np.ptp(some, axis=0)))
    length = width = breadth = 0.0
    for radius, sums in zip(radii.tolist(), moments_within(some, seeds, radii), strict=True):
        sums = sums[sums[:, 0] >= _FEWEST]  # (S, 13)
        if 2 * len(sums) < _SEEDS:
            continue
        count = sums[:, 0]
        mean = sums[:, 1:4] / count[:, None]
        spread = sums[:, 4:].reshape(-1, 3, 3) / count[:, None, None] - mean[:, :, None] * mean[:, None, :]
        values = np.maximum(np.linalg.eigvalsh(spread)[:, ::-1] * (count / (count - 1))[:, None], 0.0)
        spreads = values[:, 0], values[:, 1], values[:, 1:].sum(axis=1)
        length, width, breadth = (float(np.sqrt(12 * np.median(value))) for value in spreads)
        if length >= _ELONGATED * breadth:
            half = np.sqrt(max(radius**2 - breadth**2 / 6, 0.0))
            # A rope that grows wider along its length spreads by the mean of its squares; a crossing is no width.
            square_mean = np.minimum(spreads[2], _CROSSING * breadth**2 / 12).mean()
            return Ribbon(width, float(np.sqrt(12 * square_mean)), float(len(some) * np.mean(2 * half / count)))
    return Ribbon(width, breadth, length)


@compiled("(f8[:,::1], f8[:,::1], f8[::1])")
def moments_within(points: Array, seeds: Array, radii: Array) -> Array:
    """Return how many points lie within each radius of each seed, and the sums of their coordinates and products.

    A product of matrices would give the same. On a machine that is busy it takes ten times as long, because the threads
    of BLAS wait for each other.

    Args:
        points: ``(M, 3)``.
        seeds: ``(S, 3)``.
        radii: ``(R,)``, ascending.

    Returns:
        ``(R, S, 13)`` the number, three sums, and nine sums of products.
    """
    out, square = np.zeros((len(radii), len(seeds), 13)), radii**2
    for s in range(len(seeds)):
        for m in range(len(points)):
            off = 0.0
            for d in range(3):
                off += (points[m, d] - seeds[s, d]) ** 2
            r = np.searchsorted(square, off)
            if r == len(radii):
                continue
            out[r, s, 0] += 1
            for d in range(3):
                out[r, s, 1 + d] += points[m, d]
                for e in range(3):
                    out[r, s, 4 + 3 * d + e] += points[m, d] * points[m, e]
        for r in range(1, len(radii)):
            for k in range(13):
                out[r, s, k] += out[r - 1, s, k]
    return out
