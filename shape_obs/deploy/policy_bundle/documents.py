"""Read and write the members of a bundle: JSON, YAML and safetensors.

A bundle may come from anyone, so every member is checked before anything large is built from it: size, depth, number
of values and range of numbers of JSON and YAML, and the header of tensors.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
import yaml

from shape_obs.utils.documents import parse_json, parse_yaml
from shape_obs.utils.errors import SpecError
from shape_obs.utils.yaml_text import Dumper, Loader

if TYPE_CHECKING:
    import torch

#: Exceptions that Python, NumPy, OpenCV, PyTorch and Gymnasium raise for values that they cannot use.
MALFORMED: Final = (
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    AttributeError,
    AssertionError,
    ArithmeticError,
    RuntimeError,
    cv2.error,
)
_ADVICE: Final = "Load it with trust=True (--trust on the command line) only if you trust who made the file."

MOST_DEPTH: Final = 16
MOST_VALUES: Final = 100_000
MOST_TEXT: Final = 65_536
#: Larger whole numbers are not exact in JSON.
MOST_NUMBER: Final = 2**53

_LENGTH_BYTES: Final = 8
_MOST_HEADER: Final = 2**20
_MOST_TENSORS: Final = 4096
_MOST_DIMENSIONS: Final = 8
#: Bytes per value, by the type names of safetensors.
_BYTES: Final = {
    "F64": 8, "F32": 4, "F16": 2, "BF16": 2,
    "I64": 8, "I32": 4, "I16": 2, "I8": 1, "U8": 1, "BOOL": 1,
}  # fmt: skip


class BundleError(ValueError):
    """A bundle that cannot be read or does not fit; the message gives what was expected, what came and what to do."""


def needs_trust(what: str) -> BundleError:
    """Return the error for content that is read only with ``trust=True``: it names code, or has no known bound."""
    return BundleError(f"{what}. {_ADVICE}")


def is_number(value: Any) -> bool:
    """Return whether a value is a finite number and not a bool."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


# ---- JSON and YAML


def write_json(value: Mapping[str, Any]) -> bytes:
    """Write a JSON member with one line per entry, since the bounds of a space are long lists."""
    lines = ",\n".join(f"  {json.dumps(name)}: {json.dumps(item)}" for name, item in value.items())
    return f"{{\n{lines}\n}}\n".encode()


def read_json(data: bytes, what: str) -> dict[str, Any]:
    """Read a JSON member that is an object.

    Args:
        data: The bytes of the member; the archive has checked their number.
        what: The name of the member, for error messages.

    Raises:
        BundleError: The member is not a JSON object, repeats a name, is nested too deeply, or holds too much.
    """
    try:
        value = parse_json(data, what)
    except SpecError as error:
        raise BundleError(str(error)) from error
    return _checked(value, what)


def write_yaml(value: Any) -> bytes:
    """Write a YAML member without aliases."""
    return yaml.dump(value, Dumper=_DumperWithoutAliases, sort_keys=False).encode()


def read_yaml(data: bytes, what: str) -> dict[str, Any]:
    """Read a YAML member that is a mapping; raise as ``read_json`` does, and refuse aliases and tags."""
    try:
        value = parse_yaml(data, what, _LoaderWithoutAliases)
    except SpecError as error:
        raise BundleError(str(error)) from error
    return _checked(value, what)


class _DumperWithoutAliases(Dumper):
    def ignore_aliases(self, data: Any) -> bool:
        return True


class _LoaderWithoutAliases(Loader):
    """Load YAML safely, and stop at the first alias or beyond ``MOST_DEPTH``."""

    _depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("it has an alias (*name), which bundles do not use")
        if self._depth > MOST_DEPTH:
            raise yaml.YAMLError(f"it is nested deeper than {MOST_DEPTH} levels")
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node


def _checked(value: Any, what: str) -> dict[str, Any]:
    """Return a document if it is a mapping of JSON values within the bounds."""
    if not isinstance(value, dict):
        raise BundleError(f"{what}: expected an object, got {type(value).__name__}.")
    count = 0
    level: list[Any] = [value]
    for _ in range(MOST_DEPTH):
        count += len(level)
        if count > MOST_VALUES:
            raise BundleError(f"{what}: expected at most {MOST_VALUES} values, got more.")
        for item in level:
            _check_value(item, what)
        level = [inner for item in level for inner in _inside(item)]
        if not level:
            return value
    raise BundleError(f"{what}: it is nested deeper than {MOST_DEPTH} levels.")


def _inside(value: Any) -> list[Any]:
    if isinstance(value, Mapping):
        return list(value.values())
    return value if isinstance(value, list) else []


def _check_value(value: Any, what: str) -> None:
    if isinstance(value, dict):
        wrong = next((key for key in value if not isinstance(key, str) or len(key) > MOST_TEXT), None)
        if wrong is not None:
            raise BundleError(f"{what}: expected short text as a name, got {str(wrong)[:80]!r}.")
    elif isinstance(value, str):
        if len(value) > MOST_TEXT:
            raise BundleError(f"{what}: expected text of at most {MOST_TEXT} characters, got {len(value)}.")
    elif isinstance(value, int):
        if abs(value) > MOST_NUMBER:
            raise BundleError(f"{what}: expected whole numbers up to 2**53, got one of {value.bit_length()} bits.")
    elif not (value is None or isinstance(value, (float, list))):
        raise BundleError(f"{what}: expected JSON values, got {type(value).__name__}.")


# ---- Safetensors


class TensorType(NamedTuple):
    """Type and shape of a tensor, as the header of a safetensors file gives them.

    Attributes:
        dtype: Type name of safetensors, such as ``"F32"``.
        shape: Shape.
    """

    dtype: str
    shape: tuple[int, ...]


def read_header(data: bytes, what: str) -> dict[str, TensorType]:
    """Read and check the header: all tensors lie in the data, none overlap, and no byte is left over.

    Args:
        data: The bytes of the member.
        what: The name of the member, for error messages.

    Raises:
        BundleError: The header cannot be read, or does not describe the data.
    """
    length = int.from_bytes(data[:_LENGTH_BYTES], "little")
    if len(data) < _LENGTH_BYTES or length > min(_MOST_HEADER, len(data) - _LENGTH_BYTES):
        raise BundleError(f"{what}: its header does not fit in its {len(data)} bytes.")
    entries = read_json(data[_LENGTH_BYTES : _LENGTH_BYTES + length], f"the header of {what}")
    if len(entries) > _MOST_TENSORS:
        raise BundleError(f"{what}: expected at most {_MOST_TENSORS} tensors, got {len(entries)}.")
    types, spans = {}, []
    for name, entry in entries.items():
        types[name], span = _tensor(entry, f"{what}: tensor {name[:80]!r}")
        spans.append(span)
    end = 0
    for start, stop in sorted(spans):
        if start != end:
            raise BundleError(f"{what}: its tensors overlap, or there is a gap between them.")
        end = stop
    if end != len(data) - _LENGTH_BYTES - length:
        raise BundleError(f"{what}: its tensors take {end} bytes, it holds {len(data) - _LENGTH_BYTES - length}.")
    return types


def write_weights(state: Mapping[str, torch.Tensor]) -> bytes:
    """Write the tensors of a network; a tensor with two names is written twice."""
    from safetensors.torch import save

    return save({name: tensor.detach().cpu().clone().contiguous() for name, tensor in state.items()})


def read_weights(data: bytes, what: str) -> dict[str, torch.Tensor]:
    """Read the tensors of a network, after ``read_header`` has checked the header.

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
    """Write NumPy arrays as a safetensors member."""
    from safetensors.numpy import save

    return save({name: np.array(array) for name, array in arrays.items()})


def read_arrays(data: bytes, what: str) -> dict[str, npt.NDArray[Any]]:
    """Read NumPy arrays from a safetensors member, after checking its header.

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


def _tensor(entry: Any, where: str) -> tuple[TensorType, tuple[int, int]]:
    """Return type and byte range of a tensor from its entry in the header."""
    if not isinstance(entry, Mapping) or set(entry) != {"dtype", "shape", "data_offsets"}:
        raise BundleError(f"{where}: expected dtype, shape and data_offsets, got {_short(entry)}.")
    dtype, shape, offsets = entry["dtype"], entry["shape"], entry["data_offsets"]
    if not isinstance(dtype, str) or dtype not in _BYTES:
        raise BundleError(f"{where}: expected a dtype of {', '.join(_BYTES)}, got {_short(dtype)}.")
    if not _are_counts(shape) or len(shape) > _MOST_DIMENSIONS or not _are_counts(offsets) or len(offsets) != 2:
        raise BundleError(f"{where}: expected a shape and two offsets, got {_short(shape)} and {_short(offsets)}.")
    if offsets[1] - offsets[0] != math.prod(shape) * _BYTES[dtype]:
        raise BundleError(f"{where}: {dtype} of shape {_short(shape)} does not have {offsets[1] - offsets[0]} bytes.")
    return TensorType(dtype, tuple(shape)), (offsets[0], offsets[1])


def _are_counts(value: Any) -> bool:
    return isinstance(value, list) and all(type(item) is int and item >= 0 for item in value)


def _short(value: Any) -> str:
    return json.dumps(value)[:100]
