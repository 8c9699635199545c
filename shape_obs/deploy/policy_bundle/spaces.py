"""Describe spaces as JSON values, and normalise observations as a training did."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from shape_obs.deploy.policy_bundle.archive import STATISTICS
from shape_obs.deploy.policy_bundle.documents import MALFORMED, BundleError, read_arrays, write_arrays
from shape_obs.spec import to_plain

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecNormalize

Array = npt.NDArray[np.float64]

#: Bytes of the largest observation or action that a bundle may describe.
MOST_BYTES: Final = 16 * 2**20
_MOST_COUNT: Final = 1_000_000
_MOST_KEYS: Final = 64
_MOST_DIMENSIONS: Final = 4
_DTYPES: Final = (
    "float16", "float32", "float64",
    "uint8", "uint16", "uint32", "int8", "int16", "int32", "int64",
)  # fmt: skip


def space_to_dict(space: spaces.Space[Any]) -> dict[str, Any]:
    """Describe a space as JSON values; bounds that are all equal become one number.

    Raises:
        ValueError: The space is not a Box, Discrete, MultiDiscrete, MultiBinary, or a Dict of these.
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
        return {"kind": type(space).__name__.lower(), name: to_plain(getattr(space, name))}
    raise ValueError(f"expected a space of Box, Discrete or Dict, got {space}.")


def space_from_dict(value: Any, where: str) -> spaces.Space[Any]:
    """Rebuild the space that ``space_to_dict`` described, after checking its size.

    Args:
        value: The description, from a file.
        where: What the space is, for error messages.

    Raises:
        BundleError: It is not such a description, or a sample of the space is larger than ``MOST_BYTES``.
    """
    try:
        space, size = _rebuilt(value)
    except MALFORMED as error:
        raise BundleError(f"{where}: expected a space as save_bundle writes it: {error}") from error
    if size > MOST_BYTES:
        raise BundleError(f"{where}: expected at most {MOST_BYTES} bytes in an observation, got {size}.")
    return space


def _rebuilt(value: Mapping[str, Any]) -> tuple[spaces.Space[Any], int]:
    """Return the space, and the size of one of its samples in bytes."""
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
        return spaces.Discrete(count, start=int(value["start"])), 8 * count  # networks read it one-hot
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
    if len(shape) > _MOST_DIMENSIONS or size > MOST_BYTES:
        raise ValueError(f"a box of shape {shape} is too large")
    low, high = (_bounds(value[name], shape, dtype) for name in ("low", "high"))
    if not np.all(low <= high):
        raise ValueError("a lower bound is above the upper bound")
    return spaces.Box(low, high, shape, np.dtype(dtype).type), size


def _bounds(value: Any, shape: tuple[int, ...], dtype: str) -> npt.NDArray[Any]:
    bounds = np.asarray(value)
    if bounds.dtype.kind not in "iuf" or bounds.shape not in ((), shape):
        raise ValueError(f"expected one number or numbers of shape {shape} as bounds, got shape {bounds.shape}")
    kind = np.dtype(dtype)
    if kind.kind != "f":
        limits = np.iinfo(kind)
        if not np.all((bounds >= limits.min) & (bounds <= limits.max)):
            raise ValueError(f"its bounds exceed the range of {dtype}")
    return np.full(shape, bounds, kind)


def _count(value: Any) -> int:
    if type(value) is not int or not 1 <= value <= _MOST_COUNT:
        raise ValueError(f"expected whole numbers from 1 to {_MOST_COUNT}, got {value!r}")
    return value


def layout_differences(trained: Any, here: Any, where: str) -> Iterator[tuple[str, Any, Any]]:
    """Yield the differences in keys, shapes and types of two spaces of ``space_to_dict``: (place, trained, here).

    Bounds may differ, since they come from the workspace, which is different at each site.
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
    """Return the space as a network of Stable-Baselines3 gets it: images ``(H, W, C)`` become ``(C, H, W)``."""
    if space["kind"] == "dict":
        return {**space, "spaces": {key: channels_first(inner) for key, inner in space["spaces"].items()}}
    image = space["kind"] == "box" and space["dtype"] == "uint8" and len(space["shape"]) == 3
    if not image or space["shape"][-1] > 4:
        return dict(space)
    height, width, channels = space["shape"]
    return {**space, "shape": [channels, height, width]}


def zeros(space: spaces.Space[Any]) -> Any:
    """Return an observation of zeros."""
    if isinstance(space, spaces.Dict):
        return {key: zeros(inner) for key, inner in space.spaces.items()}
    return np.zeros(space.shape or (), space.dtype)


def _bound(values: npt.NDArray[Any]) -> Any:
    return to_plain(values.flat[0]) if values.size and np.all(values == values.flat[0]) else to_plain(values)


# ---- Statistics of observations

#: The key of an observation that is not a Dict.
WHOLE = ""
_SCALARS = ("epsilon", "clip")


@dataclass(frozen=True)
class Statistics:
    """Mean and variance of the observations, which ``VecNormalize`` has estimated.

    Args:
        mean: Mean of each value, by key; the key is ``""`` if an observation is one array.
        variance: Variance of each value, by key.
        epsilon: Number that is added to the variance.
        clip: Largest absolute value after normalisation.
    """

    mean: Mapping[str, Array]
    variance: Mapping[str, Array]
    epsilon: float
    clip: float

    @classmethod
    def of(cls, normalize: VecNormalize | None) -> Statistics | None:
        """Copy the statistics of a ``VecNormalize``; return None if it leaves observations alone."""
        if normalize is None or not normalize.norm_obs:
            return None
        if isinstance(normalize.obs_rms, dict):
            known = {key: normalize.obs_rms[key] for key in normalize.norm_obs_keys or ()}
        else:
            known = {WHOLE: normalize.obs_rms}
        mean = {key: np.array(rms.mean, np.float64) for key, rms in known.items()}
        variance = {key: np.array(rms.var, np.float64) for key, rms in known.items()}
        return cls(mean, variance, float(normalize.epsilon), float(normalize.clip_obs))

    def normalize(self, observation: Any) -> Any:
        """Normalise exactly as ``VecNormalize.normalize_obs``; keys without statistics are left alone."""
        if WHOLE in self.mean:
            return self._scaled(observation, WHOLE)
        return {key: self._scaled(value, key) if key in self.mean else value for key, value in observation.items()}

    def to_bytes(self) -> bytes:
        """Write the statistics as a safetensors member."""
        arrays = {f"mean/{key}": value for key, value in self.mean.items()}
        arrays |= {f"variance/{key}": value for key, value in self.variance.items()}
        scalars = {"epsilon": np.array(self.epsilon), "clip": np.array(self.clip)}
        return write_arrays({**arrays, **scalars})

    @classmethod
    def from_bytes(cls, data: bytes) -> Statistics:
        """Read the statistics that ``to_bytes`` wrote.

        Raises:
            BundleError: The data is something else.
        """
        return cls.from_arrays(read_arrays(data, STATISTICS))

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, npt.NDArray[Any]]) -> Statistics:
        """Create statistics from arrays with the names that ``to_bytes`` gives them.

        Raises:
            BundleError: An array is missing, or has an unknown name or type.
        """
        parts: dict[str, dict[str, Array]] = {"mean": {}, "variance": {}}
        scalars: dict[str, float] = {}
        for name, array in arrays.items():
            part, slash, key = name.partition("/")
            if array.dtype != np.float64 or (part not in parts if slash else name not in _SCALARS or array.shape != ()):
                raise BundleError(f"the statistics: unexpected array {name[:80]!r}, {array.dtype} of {array.shape}.")
            if slash:
                parts[part][key] = array
            else:
                scalars[name] = float(array)
        if parts["mean"].keys() != parts["variance"].keys() or scalars.keys() != set(_SCALARS):
            raise BundleError("the statistics: expected a mean and a variance of each observation, epsilon and clip.")
        return cls(parts["mean"], parts["variance"], scalars["epsilon"], scalars["clip"])

    def check(self, observation: Mapping[str, Any]) -> None:
        """Refuse statistics that do not fit the observations.

        Args:
            observation: The observation space, as ``space_to_dict`` describes it.

        Raises:
            BundleError: The message names the key of the observation.
        """
        spaces = observation["spaces"] if observation["kind"] == "dict" else {WHOLE: observation}
        for key, mean in self.mean.items():
            shape = tuple(spaces[key].get("shape", ())) if key in spaces else None
            variance = self.variance[key]
            if shape is None or mean.shape != shape or variance.shape != shape:
                raise BundleError(f"the statistics of observation {key[:80]!r} do not have its shape {shape}.")
            if not (np.isfinite(mean).all() and np.isfinite(variance).all() and (variance >= 0).all()):
                raise BundleError(f"the statistics of observation {key[:80]!r} are not finite, or negative.")
        if not (0 < self.epsilon < np.inf and self.clip > 0):
            raise BundleError(f"the statistics: expected epsilon and clip above 0, got {self.epsilon} and {self.clip}.")

    def _scaled(self, values: npt.ArrayLike, key: str) -> npt.NDArray[np.float32]:
        centred = np.asarray(values) - self.mean[key]
        scaled = centred / np.sqrt(self.variance[key] + self.epsilon)
        return np.clip(scaled, -self.clip, self.clip).astype(np.float32)
