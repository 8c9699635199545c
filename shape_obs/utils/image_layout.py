"""How an image may lie in an array, and the steps that make ``(H, W, 3)`` RGB or ``(H, W)`` depth of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import itemgetter, methodcaller
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

_GRAY, _RGB, _RGBA = 1, 3, 4  # channels


class Step(NamedTuple):
    """One change of an array: in words, with ``{}`` for the array, and as a function."""

    words: str
    apply: Callable[[npt.NDArray[Any]], npt.NDArray[Any]]


def _as_colours(gray: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return np.repeat(gray[..., None], _RGB, axis=-1)


# Functions that can be pickled, as wrappers are.
_UNBATCH: Final = Step("{}[0]", itemgetter(0))
_LAST: Final = Step("{}.transpose(1, 2, 0)", methodcaller("transpose", 1, 2, 0))
_OPAQUE: Final = Step("{}[..., :3]", itemgetter((..., slice(_RGB))))
_SQUEEZE: Final = Step("{}[..., 0]", itemgetter((..., 0)))
_COLOUR: Final = Step("np.dstack(3 * [{}])", _as_colours)


def steps_to_rgb(shape: Sequence[int]) -> list[Step] | None:
    """Return the steps that make ``(H, W, 3)`` of an image of a shape: batched, channels first, RGBA or gray.

    None if the shape is not that of one image.
    """
    steps = _to_channels_last(shape, (_GRAY, _RGB, _RGBA))
    if steps is None:
        return None
    channels = shape_after(shape, steps)[2:]
    more = {(): [_COLOUR], (_GRAY,): [_SQUEEZE, _COLOUR], (_RGB,): [], (_RGBA,): [_OPAQUE]}
    return [*steps, *more[channels]]


def steps_to_depth(shape: Sequence[int]) -> list[Step] | None:
    """Return the steps that make ``(H, W)`` of a depth image of a shape; None if it is not that of one image."""
    steps = _to_channels_last(shape, (_GRAY,))
    if steps is None:
        return None
    return [*steps, *([_SQUEEZE] if len(shape_after(shape, steps)) == 3 else [])]


def is_depth(dtype: np.dtype[Any] | None) -> bool:
    """Return whether numbers of a type are depth: uint16 or int16 millimetres, or floating metres."""
    return dtype is not None and (dtype.kind == "f" or (dtype.kind in "iu" and dtype.itemsize == 2))


def shape_after(shape: Sequence[int], steps: Sequence[Step]) -> tuple[int, ...]:
    """Return the shape of an array after some steps."""
    return apply(np.broadcast_to(np.uint8(0), shape), steps).shape


def apply(image: npt.NDArray[Any], steps: Sequence[Step]) -> npt.NDArray[Any]:
    """Return an image after some steps."""
    for step in steps:
        image = step.apply(image)
    return image


def advice(name: str, steps: Sequence[Step] | None) -> str:
    """Return the end of an error message about a shape, with how to make the expected one of it."""
    text = name
    for step in steps or ():
        text = step.words.format(text)
    return f": give {text}." if steps else "."


def _to_channels_last(shape: Sequence[int], channels: Sequence[int]) -> list[Step] | None:
    """Return the steps that make ``(H, W)`` or ``(H, W, C)`` of an image; None if it has another number of channels."""
    batch = [_UNBATCH] if len(shape) == 4 and shape[0] == 1 else []
    rest = tuple(shape)[len(batch) :]
    if 0 in rest or len(rest) not in (2, 3):
        return None
    if len(rest) == 2 or rest[2] in channels:
        return batch
    return [*batch, _LAST] if rest[0] in channels else None
