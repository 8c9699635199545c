"""Errors of bundles, and what a damaged or hostile value raises in the libraries that are given it.

JSON and YAML members of a bundle, bounded in size, depth and numbers.

Tensors in the safetensors format: sized by their header before anything is made of them.
"""

from __future__ import annotations
from typing import Final
import cv2
import json
import math
from collections.abc import Mapping
from typing import Any, Final
import yaml
from typing import TYPE_CHECKING, Any, Final, NamedTuple
import numpy as np
import numpy.typing as npt
if TYPE_CHECKING:
    import torch


#: What Python, NumPy, OpenCV, PyTorch and Gymnasium raise for values that they cannot use.
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



class BundleError(ValueError):
    """A bundle that cannot be read or does not fit; the message says what was expected, what came and what to do."""



def needs_trust(what: str) -> BundleError:
    """Return the error for something that is not read without ``trust=True``: it names code, or has no known bound."""
    return BundleError(f"{what}. {_ADVICE}")



MOST_DEPTH: Final = 16

MOST_VALUES: Final = 100_000

MOST_TEXT: Final = 65_536

#: Whole numbers beyond this are not exact in JSON.
MOST_NUMBER: Final = 2**53



def write_json(value: Mapping[str, Any]) -> bytes:
    """Write a JSON member: one line for each entry of its own, since bounds of a space are long lists."""
    lines = ",\n".join(f"  {json.dumps(name)}: {json.dumps(item)}" for name, item in value.items())
    return f"{{\n{lines}\n}}\n".encode()



def read_json(data: bytes, what: str) -> dict[str, Any]:
    """Read a JSON member, an object.

    Args:
        data: Its bytes; the archive has bounded how many.
        what: The member, for messages.

    Raises:
        BundleError: It is no JSON object, nested too deep, or holds too much.
    """
    try:
        value = json.loads(data, object_pairs_hook=_unique)
    except (ValueError, RecursionError) as error:
        raise BundleError(f"{what} cannot be read: {error}") from error
    return _checked(value, what)



def write_yaml(value: Any) -> bytes:
    """Write a YAML member without aliases."""
    return yaml.dump(value, Dumper=_Plain, sort_keys=False).encode()



def read_yaml(data: bytes, what: str) -> dict[str, Any]:
    """Read a YAML member, a mapping; errors as those of ``read_json``, and aliases and tags are refused."""
    try:
        value = yaml.load(data, Loader=_Bounded)
    except (yaml.YAMLError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise BundleError(f"{what} cannot be read: {error}") from error
    return _checked(value, what)



class _Plain(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:
        return True



class _Bounded(yaml.SafeLoader):
    """PyYAML's safe loader, which stops at the first alias and at the depth that is allowed."""

    _depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("it has an alias (*name), which bundles do not use")
        if self._depth > MOST_DEPTH:
            raise yaml.YAMLError(f"it is nested deeper than {MOST_DEPTH}")
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node



def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        raise ValueError("a name stands twice in one object")
    return values



def _checked(value: Any, what: str) -> dict[str, Any]:
    """Return a document that is a mapping of plain values within the bounds."""
    if not isinstance(value, dict):
        raise BundleError(f"{what}: expected an object, got {type(value).__name__}.")
    count = 0
    level: list[Any] = [value]
    for _ in range(MOST_DEPTH):
        count += len(level)
        if count > MOST_VALUES:
            raise BundleError(f"{what}: expected at most {MOST_VALUES} values, got more.")
        for item in level:
            _check_plain(item, what)
        level = [inner for item in level for inner in _inside(item)]
        if not level:
            return value
    raise BundleError(f"{what}: it is nested deeper than {MOST_DEPTH}.")



def _inside(value: Any) -> list[Any]:
    if isinstance(value, Mapping):
        return list(value.values())
    return value if isinstance(value, list) else []



def _check_plain(value: Any, what: str) -> None:
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
        raise BundleError(f"{what}: expected plain values, got {type(value).__name__}.")



def is_number(value: Any) -> bool:
    """Whether a value is a finite number and no bool."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)



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

