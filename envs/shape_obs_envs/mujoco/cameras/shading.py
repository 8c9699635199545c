"""The light on matt surfaces, as OpenGL computes it: ambient plus Lambert."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def shade(model: Any, data: Any, rgba: NDArray[Any], normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Colours (M, 3), 0 ... 1, of surfaces with colours `rgba` (M, 4) or (4,) and unit normals (M, 3), world frame."""
    facing = np.maximum(-normals @ data.light_xdir.T, 0)
    light = model.light_ambient.sum(axis=0) + facing @ model.light_diffuse
    return np.clip(rgba[..., :3] * light, 0, 1)


def to_bytes(colours: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Colours 0 ... 1 in steps of 1/255."""
    return np.rint(colours * 255).astype(np.uint8)
