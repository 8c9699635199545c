"""Compute the statistics by which LeRobot's policies are normalised."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Statistics = dict[str, Array]

_QUANTILES: Final[Mapping[str, float]] = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}


def column_statistics(column: npt.NDArray[Any]) -> Statistics:
    """Return ``min``, ``max``, ``mean``, ``std``, quantiles ``(D,)`` and ``count`` ``(1,)`` of a column.

    Args:
        column: ``(T, D)``, or ``(T,)`` for D = 1.
    """
    values = column.reshape(len(column), -1).astype(np.float64)
    quantiles = np.quantile(values, list(_QUANTILES.values()), axis=0)
    return {
        "min": values.min(axis=0),
        "max": values.max(axis=0),
        "mean": values.mean(axis=0),
        "std": values.std(axis=0),
        "count": np.array([len(values)]),
        **dict(zip(_QUANTILES, quantiles, strict=True)),
    }


def image_statistics(pixels: npt.NDArray[np.uint8], count: int) -> Statistics:
    """Return the statistics ``(3, 1, 1)`` of the colours of images, from 0 to 1.

    Args:
        pixels: Sampled pixels ``(P, 3)``.
        count: Number of images from which they were taken.
    """
    found = column_statistics(pixels / 255.0)
    return {name: value.reshape(3, 1, 1) for name, value in found.items() if name != "count"} | {
        "count": np.array([count])
    }


def merge_statistics(parts: Sequence[Statistics]) -> Statistics:
    """Return the statistics of several parts together.

    All are exact but the quantiles, which are means of the parts' quantiles weighted by their counts, as in LeRobot.
    """
    counts = np.array([part["count"][0] for part in parts], np.float64)
    total = counts.sum()

    def mean(name: str) -> Array:
        return np.tensordot(counts, np.stack([part[name] for part in parts]), axes=1) / total

    middle = mean("mean")
    spread = [part["std"] ** 2 + (part["mean"] - middle) ** 2 for part in parts]
    return {
        "min": np.min([part["min"] for part in parts], axis=0),
        "max": np.max([part["max"] for part in parts], axis=0),
        "mean": middle,
        "std": np.sqrt(np.tensordot(counts, np.stack(spread), axes=1) / total),
        "count": np.array([int(total)]),
        **{name: mean(name) for name in _QUANTILES},
    }
