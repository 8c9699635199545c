"""Spaces as JSON values, so that they can be told and compared."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from shape_obs.spec import plain


def space_to_dict(space: spaces.Space[Any]) -> dict[str, Any]:
    """What a space is, as JSON values; bounds that are all the same are one number.

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
