"""Statistics: what ``VecNormalize`` has learnt of the observations, as plain arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from shape_obs.deploy.policy_bundle.archive import STATISTICS
from shape_obs.deploy.policy_bundle.errors import BundleError
from shape_obs.deploy.policy_bundle.tensors import read_arrays, write_arrays

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecNormalize

Array = npt.NDArray[np.float64]
#: Stands for the observation itself where it is no Dict.
WHOLE = ""
_SCALARS = ("epsilon", "clip")


@dataclass(frozen=True)
class Statistics:
    """Mean and variance of the observations, by key.

    Args:
        mean: Of each value; the key is ``""`` where an observation is one array.
        variance: Of each value.
        epsilon: Added to the variance.
        clip: What a normalised value is clipped to, to either side.
    """

    mean: Mapping[str, Array]
    variance: Mapping[str, Array]
    epsilon: float
    clip: float

    @classmethod
    def of(cls, normalize: VecNormalize | None) -> Statistics | None:
        """Take what a ``VecNormalize`` has learnt; None where it leaves observations alone."""
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
        """As ``VecNormalize.normalize_obs`` does, to the bit; keys without statistics pass through."""
        if WHOLE in self.mean:
            return self._scaled(observation, WHOLE)
        return {key: self._scaled(value, key) if key in self.mean else value for key, value in observation.items()}

    def to_bytes(self) -> bytes:
        """Write them as tensors."""
        arrays = {f"mean/{key}": value for key, value in self.mean.items()}
        arrays |= {f"variance/{key}": value for key, value in self.variance.items()}
        scalars = {"epsilon": np.array(self.epsilon), "clip": np.array(self.clip)}
        return write_arrays({**arrays, **scalars})

    @classmethod
    def from_bytes(cls, data: bytes) -> Statistics:
        """Read what ``to_bytes`` wrote.

        Raises:
            BundleError: It is something else.
        """
        return cls.from_arrays(read_arrays(data, STATISTICS))

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, npt.NDArray[Any]]) -> Statistics:
        """Take them from arrays by the names that ``to_bytes`` gives them.

        Raises:
            BundleError: An array is missing, has another name or type.
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
            observation: The space, as ``space_to_dict`` describes it.

        Raises:
            BundleError: The message names the observation.
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
