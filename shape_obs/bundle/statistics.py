"""Statistics: what ``VecNormalize`` has learnt of the observations, as plain arrays."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecNormalize

Array = npt.NDArray[np.float64]
#: Stands for the observation itself where it is no Dict.
WHOLE = ""


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
        """What a ``VecNormalize`` has learnt; None where it leaves observations alone."""
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
        """A .npz file of them."""
        arrays = {f"mean/{key}": value for key, value in self.mean.items()}
        arrays |= {f"variance/{key}": value for key, value in self.variance.items()}
        buffer = io.BytesIO()
        np.savez(buffer, **arrays, epsilon=np.float64(self.epsilon), clip=np.float64(self.clip))  # type: ignore[arg-type]
        return buffer.getvalue()

    @classmethod
    def from_bytes(cls, data: bytes) -> Statistics:
        """Read what ``to_bytes`` wrote."""
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            parts: dict[str, dict[str, Array]] = {"mean": {}, "variance": {}}
            for name in arrays.files:
                part, slash, key = name.partition("/")
                if slash:
                    parts[part][key] = arrays[name]
            return cls(parts["mean"], parts["variance"], float(arrays["epsilon"]), float(arrays["clip"]))

    def _scaled(self, values: npt.ArrayLike, key: str) -> npt.NDArray[np.float32]:
        centred = np.asarray(values) - self.mean[key]
        scaled = centred / np.sqrt(self.variance[key] + self.epsilon)
        return np.clip(scaled, -self.clip, self.clip).astype(np.float32)
