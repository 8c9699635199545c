"""Read arrays of other kinds than NumPy's plain one: masked arrays, tensors, pictures, tables, another byte order."""

from __future__ import annotations

from typing import Any

import numpy as np


def plain_array(value: Any, name: str, masked: float | None = None) -> Any:
    """Return the numbers of an array-like as a plain array in the machine's byte order; itself if it is one.

    What is no array-like, such as a list, is returned as it is.

    Args:
        value: Such as a ``numpy.ma.MaskedArray``, a tensor on the CPU, a PIL image or an xarray.
        name: What error messages call it.
        masked: The value that masked entries get; None refuses a mask that hides any.

    Raises:
        TypeError: Its numbers cannot be read, or carry a unit.
        ValueError: Its mask cannot be honoured.
    """
    if type(value) is np.ndarray and value.dtype.isnative:
        return value
    if hasattr(value, "get_data") and not hasattr(value, "__array__"):
        units = " * frame.get_units()" if hasattr(value, "get_units") else ""
        raise TypeError(f"{name}: got a frame of librealsense; give np.asanyarray(frame.get_data()){units}.")
    unit = getattr(value, "units", None) or getattr(value, "unit", None)
    if unit is not None and hasattr(value, "__array__"):
        raise TypeError(f"{name}: the array carries the unit {unit}: convert it, and give its bare numbers.")
    if isinstance(value, np.ma.MaskedArray):
        if masked is not None:
            return plain_array(value.filled(masked), name)
        if np.ma.is_masked(value):
            raise ValueError(
                f"{name}: the mask of this masked array would be ignored; give its .data, and mask the object "
                "with a segmentation function or detect_mask."
            )
        value = value.data
    if not hasattr(value, "__array__") and not hasattr(value, "__array_interface__"):
        return value
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, RuntimeError) as error:  # a tensor on a GPU, or one with a gradient
        raise TypeError(f"{name}: this {type(value).__name__} cannot be read as a NumPy array: {error}") from error
    return array if array.dtype.isnative else array.astype(array.dtype.newbyteorder("="))
