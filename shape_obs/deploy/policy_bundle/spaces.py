"""Spaces as JSON values, so that they can be written, compared and rebuilt."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from shape_obs.deploy.policy_bundle.errors import MALFORMED, BundleError
from shape_obs.spec import to_plain as plain

#: Of one observation or action that a bundle may describe.
MOST_BYTES: Final = 16 * 2**20
_MOST_COUNT: Final = 1_000_000
_MOST_KEYS: Final = 64
_MOST_SIDES: Final = 4
_DTYPES: Final = (
    "float16", "float32", "float64",
    "uint8", "uint16", "uint32", "int8", "int16", "int32", "int64",
)  # fmt: skip


def space_to_dict(space: spaces.Space[Any]) -> dict[str, Any]:
    """Describe a space as JSON values; bounds that are all the same are one number.

    Raises:
        ValueError: Neither a Box, nor Discrete, MultiDiscrete or MultiBinary, nor a Dict of these.
    """
    if isinstance(space, spaces.Dict):
        return {"kind": "dict", "spaces": {key: space_to_dict(inner) for key, inner in space.spaces.items()}}
    if isinstance(space, spaces.Box):
        bounds = {"low": _bound(space.low), "high": _bound(space.high)}
        return {"kind": "box", "shape": list(space.shape), "dtype": str(space.dtype), **bounds}
    if isinstance(space, spaces.Discrete):
        return {"kind": "discrete", "n": int(space.n), "start": int(space.start)}
    if isinstance(space, (spaces.MultiDiscrete, spaces.MultiBinary)):
        name = "nvec" if isinstance(space, spaces.MultiDiscrete) else "n"
        return {"kind": type(space).__name__.lower(), name: plain(getattr(space, name))}
    raise ValueError(f"expected a space of Box, Discrete or Dict, got {space}.")


def space_from_dict(value: Any, where: str) -> spaces.Space[Any]:
    """Rebuild the space that ``space_to_dict`` described, after checking how much it takes.

    Args:
        value: The description, from a file.
        where: What it is, for messages.

    Raises:
        BundleError: It is no such description, or the space takes more than ``MOST_BYTES``.
    """
    try:
        space, size = _rebuilt(value)
    except MALFORMED as error:
        raise BundleError(f"{where}: expected a space as save_bundle writes it: {error}") from error
    if size > MOST_BYTES:
        raise BundleError(f"{where}: expected at most {MOST_BYTES} bytes in an observation, got {size}.")
    return space


def _rebuilt(value: Mapping[str, Any]) -> tuple[spaces.Space[Any], int]:
    """(the space, bytes of one of its samples)."""
    kind = value["kind"]
    if kind == "dict":
        parts = {str(key): _rebuilt(inner) for key, inner in value["spaces"].items() if inner["kind"] != "dict"}
        if not 0 < len(parts) == len(value["spaces"]) <= _MOST_KEYS:
            raise ValueError(f"expected 1 to {_MOST_KEYS} keys and no Dict within a Dict")
        ordered = OrderedDict((key, space) for key, (space, _) in parts.items())  # Dict sorts any other mapping
        return spaces.Dict(ordered), sum(size for _, size in parts.values())
    if kind == "box":
        return _box(value)
    if kind == "discrete":
        count = _count(value["n"])
        return spaces.Discrete(count, start=int(value["start"])), 8 * count  # networks read it as one number for each
    if kind == "multidiscrete":
        counts = [_count(n) for n in value["nvec"]]
        return spaces.MultiDiscrete(counts), 8 * _count(sum(counts))
    if kind == "multibinary":
        return spaces.MultiBinary(_count(value["n"])), _count(value["n"])
    raise ValueError(f"unknown kind {kind!r}")


def _box(value: Mapping[str, Any]) -> tuple[spaces.Space[Any], int]:
    dtype = str(value["dtype"])
    if dtype not in _DTYPES:
        raise ValueError(f"expected a dtype of {', '.join(_DTYPES)}, got {dtype!r}")
    shape = tuple(_count(side) for side in value["shape"])
    size = math.prod(shape) * np.dtype(dtype).itemsize
    if len(shape) > _MOST_SIDES or size > MOST_BYTES:
        raise ValueError(f"a box of shape {shape} is too large")
    low, high = (_bounds(value[name], shape, dtype) for name in ("low", "high"))
    if not np.all(low <= high):
        raise ValueError("a lowest value is above the highest one")
    return spaces.Box(low, high, shape, np.dtype(dtype).type), size


def _bounds(value: Any, shape: tuple[int, ...], dtype: str) -> npt.NDArray[Any]:
    bounds = np.asarray(value)
    if bounds.dtype.kind not in "iuf" or bounds.shape not in ((), shape):
        raise ValueError(f"expected one number or numbers of shape {shape} as bounds, got shape {bounds.shape}")
    kind = np.dtype(dtype)
    if kind.kind != "f":
        limits = np.iinfo(kind)
        if not np.all((bounds >= limits.min) & (bounds <= limits.max)):
            raise ValueError(f"bounds outside of {dtype}")
    return np.full(shape, bounds, kind)


def _count(value: Any) -> int:
    if type(value) is not int or not 1 <= value <= _MOST_COUNT:
        raise ValueError(f"expected whole numbers from 1 to {_MOST_COUNT}, got {value!r}")
    return value


def layout_differences(trained: Any, here: Any, where: str) -> Iterator[tuple[str, Any, Any]]:
    """Places where two spaces of ``space_to_dict`` have other keys, shapes or types: (place, trained, here).

    Bounds may differ: they come from a workspace, which is another one at each site.
    """
    if trained["kind"] == here["kind"] == "dict":
        one, other = trained["spaces"], here["spaces"]
        if one.keys() != other.keys():
            yield f"{where} keys", sorted(one), sorted(other)
            return
        for key in one:
            yield from layout_differences(one[key], other[key], f"{where} {key!r}")
        return
    for name in ("kind", "shape", "dtype", "n", "nvec"):
        if trained.get(name) != here.get(name):
            yield f"{where} {name}", trained.get(name), here.get(name)


def channels_first(space: Mapping[str, Any]) -> dict[str, Any]:
    """The space as Stable-Baselines3 shows it to a network: images (H,W,C) as (C,H,W)."""
    if space["kind"] == "dict":
        return {**space, "spaces": {key: channels_first(inner) for key, inner in space["spaces"].items()}}
    image = space["kind"] == "box" and space["dtype"] == "uint8" and len(space["shape"]) == 3
    if not image or space["shape"][-1] > 4:
        return dict(space)
    height, width, channels = space["shape"]
    return {**space, "shape": [channels, height, width]}


def zeros(space: spaces.Space[Any]) -> Any:
    """An observation of nothing."""
    if isinstance(space, spaces.Dict):
        return {key: zeros(inner) for key, inner in space.spaces.items()}
    return np.zeros(space.shape or (), space.dtype)


def _bound(values: npt.NDArray[Any]) -> Any:
    return plain(values.flat[0]) if values.size and np.all(values == values.flat[0]) else plain(values)
