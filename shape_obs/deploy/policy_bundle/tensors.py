"""Tensors in the safetensors format: sized by their header before anything is made of them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.deploy.policy_bundle.documents import read_json
from shape_obs.deploy.policy_bundle.errors import BundleError

if TYPE_CHECKING:
    import torch

_LENGTH: Final = 8
_MOST_HEADER: Final = 2**20
_MOST_TENSORS: Final = 4096
_MOST_SIDES: Final = 8
#: Bytes of a value.
_BYTES: Final = {
    "F64": 8, "F32": 4, "F16": 2, "BF16": 2,
    "I64": 8, "I32": 4, "I16": 2, "I8": 1, "U8": 1, "BOOL": 1,
}  # fmt: skip


class Layout(NamedTuple):
    """What a header says of a tensor.

    Args:
        dtype: As safetensors names it.
        shape: Its sides.
    """

    dtype: str
    shape: tuple[int, ...]


def read_header(data: bytes, what: str) -> dict[str, Layout]:
    """Read and check the header: every tensor lies in the data, none overlaps another, and nothing is left over.

    Args:
        data: The member.
        what: Its name, for messages.

    Raises:
        BundleError: The header cannot be read, or does not describe the data.
    """
    length = int.from_bytes(data[:_LENGTH], "little")
    if len(data) < _LENGTH or length > min(_MOST_HEADER, len(data) - _LENGTH):
        raise BundleError(f"{what}: its header does not fit in its {len(data)} bytes.")
    entries = read_json(data[_LENGTH : _LENGTH + length], f"the header of {what}")
    if len(entries) > _MOST_TENSORS:
        raise BundleError(f"{what}: expected at most {_MOST_TENSORS} tensors, got {len(entries)}.")
    layouts, spans = {}, []
    for name, entry in entries.items():
        layout, span = _layout(entry, f"{what}: tensor {name[:80]!r}")
        layouts[name] = layout
        spans.append(span)
    at = 0
    for start, end in sorted(spans):
        if start != at:
            raise BundleError(f"{what}: its tensors overlap, or something lies between them.")
        at = end
    if at != len(data) - _LENGTH - length:
        raise BundleError(f"{what}: its tensors have {at} bytes, it holds {len(data) - _LENGTH - length}.")
    return layouts


def write_weights(state: Mapping[str, torch.Tensor]) -> bytes:
    """Write the tensors of a network; one that stands under two names is written twice."""
    from safetensors.torch import save

    return save({name: tensor.detach().cpu().clone().contiguous() for name, tensor in state.items()})


def read_weights(data: bytes, what: str) -> dict[str, torch.Tensor]:
    """Read the tensors of a network; the header has been checked.

    Raises:
        BundleError: They cannot be read, or hold numbers that are not finite.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load

    try:
        state = load(data)
    except (SafetensorError, ValueError, RuntimeError) as error:
        raise BundleError(f"{what} cannot be read: {error}") from error
    for name, tensor in state.items():
        if not bool(tensor.isfinite().all()):
            raise BundleError(f"{what}: tensor {name!r} holds numbers that are not finite.")
    return state


def write_arrays(arrays: Mapping[str, npt.NDArray[Any]]) -> bytes:
    """Write NumPy arrays."""
    from safetensors.numpy import save

    return save({name: np.array(array) for name, array in arrays.items()})


def read_arrays(data: bytes, what: str) -> dict[str, npt.NDArray[Any]]:
    """Read NumPy arrays.

    Raises:
        BundleError: They cannot be read.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load

    read_header(data, what)
    try:
        return load(data)
    except (SafetensorError, ValueError, KeyError, TypeError) as error:
        raise BundleError(f"{what} cannot be read: {error}") from error


def _layout(entry: Any, where: str) -> tuple[Layout, tuple[int, int]]:
    if not isinstance(entry, Mapping) or set(entry) != {"dtype", "shape", "data_offsets"}:
        raise BundleError(f"{where}: expected dtype, shape and data_offsets, got {_short(entry)}.")
    dtype, shape, offsets = entry["dtype"], entry["shape"], entry["data_offsets"]
    if not isinstance(dtype, str) or dtype not in _BYTES:
        raise BundleError(f"{where}: expected a dtype of {', '.join(_BYTES)}, got {_short(dtype)}.")
    if not _whole(shape) or len(shape) > _MOST_SIDES or not _whole(offsets) or len(offsets) != 2:
        raise BundleError(f"{where}: expected a shape and two offsets, got {_short(shape)} and {_short(offsets)}.")
    if offsets[1] - offsets[0] != math.prod(shape) * _BYTES[dtype]:
        raise BundleError(f"{where}: {dtype} of shape {_short(shape)} does not have {offsets[1] - offsets[0]} bytes.")
    return Layout(dtype, tuple(shape)), (offsets[0], offsets[1])


def _whole(value: Any) -> bool:
    return isinstance(value, list) and all(type(item) is int and item >= 0 for item in value)


def _short(value: Any) -> str:
    return json.dumps(value)[:100]
