"""One RGB-D frame, checked once at the door so that no stage behind it needs to."""

from __future__ import annotations

import math
import numbers
from dataclasses import dataclass, field
from datetime import timedelta
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.camera import CameraModel, as_camera_model
from shape_obs.compiled import compiled
from shape_obs.utils.image_layout import advice, apply, is_depth, steps_to_depth, steps_to_rgb

MILLIMETRE: Final = 1e-3  # metres; the unit of depth in whole numbers
FARTHEST: Final = 1e6  # metres; what lies beyond is garbage, and would overflow single precision
DepthImages = tuple[npt.NDArray[np.uint16], npt.NDArray[np.float32]]
#: The type of ``DepthImages`` as compiled functions declare it.
DEPTH_TYPE: Final = "Tuple((Array(u2, 2, 'C', readonly=True), Array(f4, 2, 'C', readonly=True)))"
# Types as NumPy holds them, which compare several times as fast as their classes.
_BYTE, _WORD, _SINGLE = np.dtype(np.uint8), np.dtype(np.uint16), np.dtype(np.float32)
_NO_DEPTH: Final = np.zeros((0, 0), np.float32)
_NO_MILLIMETRES: Final = np.zeros((0, 0), np.uint16)
_NO_DEPTH.flags.writeable = _NO_MILLIMETRES.flags.writeable = False


@dataclass(frozen=True)
class Frame:
    """What a camera saw at one instant.

    Args:
        rgb: ``(H, W, 3)`` uint8, RGB order; None when only a mask or depth is at hand.
        depth: (H,W) uint16 or int16 millimetres or floating metres along the optical axis; 0, negative, non-finite,
            masked or absurd (1000 km) = invalid. What is neither uint16 nor float32, or not stored row by row, is
            converted here.
        camera: The camera model, or what ``as_camera_model`` makes one of; needed for 3D and for anchors in the base
            frame.
        stamp: Seconds, or a time difference of NumPy or ``datetime``; None when the source has no clock.
        received: When it reached this machine: ``time.monotonic()``, seconds; None if unknown.
        number: The source's own count of its frames; gaps are missed frames. None if it does not count.
        exposed: The earliest time at which its exposure can have begun: ``time.monotonic()``, seconds; None if unknown.

    Attributes:
        size: ``(H, W)`` of rgb and depth, pixels; None without either.

    Raises:
        TypeError: A wrong array type or dtype.
        ValueError: A wrong shape, or sizes that differ between rgb, depth and camera.
    """

    rgb: npt.NDArray[np.uint8] | None = None
    depth: npt.NDArray[Any] | None = None
    camera: CameraModel | None = None
    stamp: float | None = None
    received: float | None = None
    number: int | None = None
    exposed: float | None = None
    size: tuple[int, int] | None = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        rgb = None if self.rgb is None else _checked_rgb(self.rgb)
        depth = None if self.depth is None else _checked_depth(self.depth)
        if rgb is not None and depth is not None and depth.shape != rgb.shape[:2]:
            raise ValueError(
                f"depth has {_size(depth)}, rgb has {_size(rgb)}: "
                "give depth aligned to the colour image (rs.align, or render both with one camera)."
            )
        image = rgb if rgb is not None else depth
        size = None if image is None else image.shape[:2]
        camera, stamp = as_camera_model(self.camera, size), self.stamp
        if camera is not None and image is not None:
            width, height = camera.intrinsics.width, camera.intrinsics.height
            if (height, width) != size:
                raise ValueError(
                    f"the camera's intrinsics are for {width} x {height} pixels, the image has "
                    f"{image.shape[1]} x {image.shape[0]}: give the intrinsics of this stream."
                )
        if isinstance(stamp, (timedelta, np.timedelta64)):
            stamp = float(np.timedelta64(stamp) / np.timedelta64(1, "s"))
        if stamp is not None and not isinstance(stamp, numbers.Real):
            raise TypeError(f"stamp must be a number of seconds, got {stamp!r}.")
        if stamp is not None and not math.isfinite(stamp):
            raise ValueError(f"stamp must be a finite number of seconds, got {stamp}.")
        for name, value in (("rgb", rgb), ("depth", depth), ("camera", camera), ("stamp", stamp), ("size", size)):
            object.__setattr__(self, name, value)


def depth_images(depth: npt.NDArray[Any] | None) -> DepthImages:
    """Return depth as compiled code reads it: a pair of images of one type, in millimetres and in metres, one empty.

    Args:
        depth: ``(H, W)`` uint16 or float32, as a frame holds it; None gives two that are empty.
    """
    if depth is None:
        return _NO_MILLIMETRES, _NO_DEPTH
    shown = depth.view()
    shown.flags.writeable = False
    return (shown, _NO_DEPTH) if shown.dtype == _WORD else (_NO_MILLIMETRES, shown)


@compiled(inline=True)
def unit_of(depth: DepthImages) -> float:
    """Return the unit in which depth is stored, metres."""
    return MILLIMETRE if len(depth[0]) > 0 else 1.0


@compiled(inline=True)
def metres_at(depth: DepthImages, row: int, column: int) -> float:
    """Return the depth of a pixel within the image, metres; not between 0 and ``FARTHEST`` where it is not known."""
    millimetres, metric = depth
    return millimetres[row, column] * MILLIMETRE if len(millimetres) > 0 else float(metric[row, column])


def depth_in_metres(depth: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """Convert depth values to metres, NaN where invalid; for the few values that a stage reads, not for images."""
    metres = depth.astype(np.float64) * (MILLIMETRE if depth.dtype.kind in "iu" else 1.0)
    metres[~((metres > 0) & (metres < FARTHEST))] = np.nan
    return metres


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


def _checked_rgb(given: Any) -> npt.NDArray[np.uint8]:
    rgb = plain_array(given, "rgb")
    if not isinstance(rgb, np.ndarray) or rgb.dtype != _BYTE:
        raise TypeError(
            f"rgb: expected a numpy array of uint8 (0...255), got {_describe(rgb)}; scale floats in 0...1 by 255."
        )
    if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.size == 0:
        hint = advice("rgb", steps_to_rgb(rgb.shape))
        raise ValueError(f"rgb: expected shape (H, W, 3), RGB order, got {rgb.shape}{hint}")
    return rgb


def _checked_depth(given: Any) -> npt.NDArray[Any]:
    depth = plain_array(given, "depth", masked=0)
    if not isinstance(depth, np.ndarray) or not is_depth(depth.dtype):
        whole = isinstance(depth, np.ndarray) and depth.dtype.kind in "iu"
        hint = "; of whole millimetres give depth.astype(np.uint16)" if whole else ""
        raise TypeError(f"depth: expected 16-bit millimetres or floating metres, got {_describe(depth)}{hint}.")
    if depth.ndim != 2 or depth.size == 0:
        steps = steps_to_depth(depth.shape)
        if steps is None:
            raise ValueError(f"depth: expected shape (H, W), got {depth.shape}.")
        depth = apply(depth, steps)
    if depth.dtype == np.int16:
        depth = np.maximum(depth, 0).astype(_WORD)
    elif depth.dtype != _WORD and depth.dtype != _SINGLE:
        with np.errstate(over="ignore"):  # what overflows becomes infinite, which is no depth
            depth = depth.astype(np.float32)
    return np.ascontiguousarray(depth)


def _size(image: npt.NDArray[Any]) -> str:
    return f"{image.shape[1]} x {image.shape[0]} pixels"


def _describe(value: Any) -> str:
    return f"an array of {value.dtype}" if isinstance(value, np.ndarray) else f"{type(value).__name__}"
