"""Check masks from elsewhere: what a mask function or a user's rule returns, and what ``detect_mask`` is given."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.frame import Frame, plain_array

_FLAG, _BYTE = np.dtype(np.bool_), np.dtype(np.uint8)
_FULL: Final = 255
_SHOWN: Final = 6  # values that an error message lists


def checked_mask(mask: Any, size: tuple[int, int] | None, whose: str) -> npt.NDArray[np.uint8]:
    """Return a mask as uint8 if it is one; without a copy if it is bool or uint8.

    Args:
        mask: ``(H, W)`` bool, or whole numbers that are all 0 and 1, or all 0 and 255; a masked value is background.
        size: ``(H, W)`` that it must have; None for any.
        whose: Where the mask comes from, the start of error messages.

    Returns:
        ``(H, W)`` uint8, 0 and 1 or 0 and 255.

    Raises:
        TypeError: It is no array, or an array of other than bool or whole numbers.
        ValueError: It has another shape or other values.
    """
    mask = plain_array(mask, whose, masked=0)
    if not isinstance(mask, np.ndarray) or mask.dtype.kind not in "bui":
        raise TypeError(f"{whose}: expected a numpy array of bool or uint8, got {_described(mask)}")
    if mask.ndim != 2 or mask.size == 0 or (size is not None and mask.shape != size):
        expected = "(H, W)" if size is None else f"{size}"
        raise ValueError(f"{whose}: expected shape {expected}, got {mask.shape}{_advice(mask.shape, size)}")
    if mask.dtype == _FLAG:
        return mask.view(np.uint8)
    if mask.dtype != _BYTE:
        _check_values(mask, whose)
        return np.not_equal(mask, 0).view(np.uint8)
    # As signed bytes 255 is -1, so the lowest and the highest value are enough to recognise a mask.
    low, high = (signed := mask.view(np.int8)).min(), signed.max()
    if low < -1 or high > 1 or low < 0 < high:
        _check_values(mask, whose)
    return mask


def check_given_mask(mask: Any, frame: Frame) -> npt.NDArray[np.uint8]:
    """Return the mask that a user gives with a frame as uint8, without a copy.

    Args:
        mask: As for ``checked_mask``.
        frame: The images and the camera, which must have the mask's size.

    Raises:
        TypeError: It is no array, or an array of other than bool or whole numbers.
        ValueError: A wrong shape, another size than the images or the camera, or other values.
    """
    checked = checked_mask(mask, None, "mask")
    camera = frame.camera and frame.camera.intrinsics.size
    image = "rgb" if frame.depth is None else "depth"
    for name, other in ((image, frame.size), ("the camera's intrinsics", camera)):
        if other is not None and other != checked.shape:
            height, width = checked.shape
            raise ValueError(
                f"the mask has {width} x {height} pixels, {name} {other[1]} x {other[0]}: they must be equal."
            )
    return checked


def _check_values(mask: npt.NDArray[Any], whose: str) -> None:
    """Raise an error if a mask of whole numbers holds other values than 0 and 1, or 0 and 255."""
    values = np.unique(mask)
    if set(values.tolist()) <= {0, 1} or set(values.tolist()) <= {0, _FULL}:
        return
    shown = ", ".join(map(str, values[:_SHOWN].tolist())) + (", ..." if len(values) > _SHOWN else "")
    raise ValueError(
        f"{whose}: expected only the values 0 and 1, or 0 and 255, got {shown}. Of an image of labels return one, such "
        "as labels == 1; of a gray image the part above a threshold, such as gray > 127."
    )


def _described(value: Any) -> str:
    """Return what a value is, and how a mask is made of it."""
    if isinstance(value, np.ndarray):
        floats = value.dtype.kind == "f"
        return f"an array of {value.dtype}{': compare it with a threshold, such as mask > 0.5.' if floats else '.'}"
    name = type(value).__name__
    if value is None:
        return f"{name}: return the mask."
    return f"{name}{': return its .cpu().numpy().' if hasattr(value, 'cpu') else '.'}"


def _advice(shape: tuple[int, ...], size: tuple[int, int] | None) -> str:
    """Return how to correct the shape of a mask, as the end of an error message."""
    if len(shape) == 3 and 1 in (shape[0], shape[2]):
        return f": take mask[{'0' if shape[0] == 1 else '..., 0'}]."
    if size is None or len(shape) != 2:
        return "."
    if shape == size[::-1]:
        return ": it is transposed; return mask.T."
    return ": resize it with cv2.resize(mask, (width, height), interpolation=cv2.INTER_NEAREST)."
