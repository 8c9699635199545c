"""Read the intrinsics of cameras as librealsense, ROS, OpenCV and Open3D describe them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

Fields = Mapping[str, Any]

#: Names of K and D in ROS 2, ROS 1, ROS's calibration files, OpenCV's samples and Open3D.
_MATRIX: Final = ("k", "K", "camera_matrix", "intrinsic_matrix")
_COEFFICIENTS: Final = (
    "d",
    "D",
    "distortion_coefficients",
    "dist_coeffs",
    "dist_coeff",
    "distCoeffs",
    "dist",
    "distortion",
)
#: What names of coefficients have in common.
_LIKE_COEFFICIENTS: Final = re.compile("dist(?!ance)|coef", re.IGNORECASE)
_WIDTH, _HEIGHT = ("width", "image_width"), ("height", "image_height")
#: ROS's models that are OpenCV's polynomial; the terms behind the fifth must be 0.
_POLYNOMIAL: Final = ("", "plumb_bob", "rational_polynomial", "none", "pinhole")
_TERMS: Final = (0, 4, 5, 8, 12, 14)  # numbers of coefficients in OpenCV
#: Field of ``Intrinsics`` -> librealsense's.
_NAMES: Final = {"width": "width", "height": "height", "fx": "fx", "fy": "fy", "cx": "ppx", "cy": "ppy"}
#: librealsense's models; it projects the inverse and the modified one in the same way.
_REALSENSE: Final = {
    "none": "pinhole",
    "brown_conrady": "brown_conrady",
    "inverse_brown_conrady": "inverse_brown_conrady",
    "modified_brown_conrady": "inverse_brown_conrady",
}
_SKEW: Final = 1e-6  # of the focal length; less in K is rounding
_CENTRAL: Final = 0.2  # share of the image by which the principal point of a K without a size may be off the middle
_RECTIFY: Final = "rectify the image (cv2.undistort, cv2.fisheye, image_proc) and give the intrinsics of the result"

Get = Callable[[str], Any]


def read_fields(camera: Any, size: tuple[int, int] | None) -> Fields:
    """Return the fields of ``Intrinsics`` that an object of another library, a mapping or matrices describe.

    Args:
        camera: See ``shape_obs.camera.as_camera_model``.
        size: ``(H, W)`` of the images, for a K without a size.

    Raises:
        TypeError: It describes no camera.
        ValueError: The size is missing, K is none, or the lens model is not one of ``Intrinsics``.
    """
    if callable(getattr(camera, "get_intrinsics", None)):  # rs.video_stream_profile
        camera = camera.get_intrinsics()
    get: Get = camera.get if isinstance(camera, Mapping) else lambda name: getattr(camera, name, None)
    if get("ppx") is not None:
        return _realsense(get)
    matrix = _first(get, _MATRIX)
    if matrix is not None:
        _check_whole_image(get)
        _check_coefficients(camera, get)
        width, height = _first(get, _WIDTH), _first(get, _HEIGHT)
        given = None if width is None or height is None else (int(height), int(width))
        model = str(get("distortion_model") or "")
        return _opencv(matrix, _first(get, _COEFFICIENTS), given, size, model)
    if isinstance(camera, Mapping):
        return camera
    if not (isinstance(camera, Sequence) or hasattr(camera, "__array__")) or isinstance(camera, (str, bytes)):
        raise TypeError(
            "camera: expected Intrinsics, a CameraModel, rs.intrinsics, a ROS CameraInfo or OpenCV's K, (K, D) or "
            f"(K, D, (width, height)), got {type(camera).__name__}."
        )
    parts = list(camera) if len(camera) and np.shape(camera[0]) == (3, 3) else [camera]
    given, coefficients = None, None
    for part in parts[1:]:
        if np.size(part) == 2:  # OpenCV's order; no lens has two coefficients
            width, height = np.ravel(part).tolist()
            given = int(height), int(width)
        else:
            coefficients = part
    return _opencv(parts[0], coefficients, given, size, "")


def _first(get: Get, names: Sequence[str]) -> Any:
    """Return the first of some values that is there; of the matrices in ROS's calibration files their numbers."""
    value = next((value for name in names if (value := get(name)) is not None), None)
    return value.get("data", value) if isinstance(value, Mapping) else value


def _realsense(get: Get) -> Fields:
    name = str(get("model")).lower().replace(" ", "_").removeprefix("distortion.").removeprefix("rs2_distortion_")
    given = get("coeffs")
    coefficients = () if given is None else tuple(float(value) for value in given)
    if (get("model") is None and any(coefficients)) or (given is None and name != "none"):
        raise ValueError(
            f"camera: distortion is a model and its coeffs, got model {get('model')!r} and coeffs {given!r}: give "
            f"both, the model as one of librealsense's {', '.join(_REALSENSE)}; 'none' if the image is rectified."
        )
    if not any(coefficients) and name in _REALSENSE:
        name = "none"
    if name not in _REALSENSE:
        raise ValueError(
            f"camera: the lens model is {name!r}, expected one of librealsense's {', '.join(_REALSENSE)}: {_RECTIFY}."
        )
    values = {ours: get(theirs) for ours, theirs in _NAMES.items()}
    for ours, theirs in _NAMES.items():
        if get(ours) not in (None, values[ours]):
            raise ValueError(f"camera: {ours} is {get(ours)!r} and {theirs} {values[ours]!r}: leave one out.")
    return {**values, "model": _REALSENSE[name], "coeffs": coefficients if name != "none" else 5 * (0.0,)}


def _check_whole_image(get: Get) -> None:
    """Refuse a ``CameraInfo`` of a part of the image, or of a reduced one: its K is that of the whole image."""
    roi = get("roi")
    part = roi.get if isinstance(roi, Mapping) else lambda name: getattr(roi, name, 0)
    if max(get("binning_x") or 0, get("binning_y") or 0) > 1 or part("x_offset") or part("y_offset"):
        raise ValueError("camera: binning and regions of interest are not supported; give the CameraInfo of the image.")


def _check_coefficients(camera: Any, get: Get) -> None:
    """Refuse distortion under a name that is not known, which would be ignored."""
    names = camera if isinstance(camera, Mapping) else getattr(camera, "__dict__", ())
    for name in names:
        unknown = name not in (*_COEFFICIENTS, "distortion_model") and not str(name).startswith("_")
        if unknown and _LIKE_COEFFICIENTS.search(str(name)) and get(name) is not None:
            raise ValueError(
                f"camera: {name!r} next to K is not known. Is it the distortion (k1, k2, p1, p2, k3)? Then call it one "
                f"of {', '.join(_COEFFICIENTS)}; if not, leave it out."
            )


def _opencv(
    matrix: Any, coefficients: Any, given: tuple[int, int] | None, size: tuple[int, int] | None, model: str
) -> Fields:
    """Return the fields of OpenCV's K and D.

    Args:
        matrix: K, ``(3, 3)`` or its nine numbers row by row.
        coefficients: D, in OpenCV's order; None for a pinhole.
        given: ``(H, W)`` that belongs to K; None if unknown.
        size: ``(H, W)`` of the images; None if unknown.
        model: ROS's distortion model.
    """
    k = _numbers(matrix, "K")
    if k.size != 9:
        raise ValueError(f"camera: expected K as a 3 x 3 matrix, got shape {np.shape(matrix)}.")
    k = k.reshape(3, 3)
    if not k[:2, :2].any():
        raise ValueError("camera: K is all zero: this camera is not calibrated.")
    if max(abs(k[0, 1]), abs(k[1, 0])) > _SKEW * abs(k[0, 0]) or not np.allclose(k[2], (0, 0, 1)):
        raise ValueError(f"camera: expected K as [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got {k.tolist()}.")
    d = np.zeros(0) if coefficients is None else _numbers(coefficients, "D")
    if model not in _POLYNOMIAL or d.size not in _TERMS or d[5:].any():
        raise ValueError(
            f"camera: the distortion model {model!r} with coefficients {d.tolist()} is not supported, expected "
            f"OpenCV's (k1, k2, p1, p2, k3) and further terms of 0: {_RECTIFY}."
        )
    (fx, _, cx), (_, fy, cy) = k[:2].tolist()
    height, width = given or (size if size and len(size) == 2 else (0, 0))
    if not (height and width):
        raise ValueError("camera: K has no image size; give (K, D, (width, height)), D being None for a pinhole.")
    if given is None and max(abs(cx / width - 0.5), abs(cy / height - 0.5)) > _CENTRAL:
        raise ValueError(
            f"camera: K has its principal point at ({cx:g}, {cy:g}), far from the middle of the image of {width} x "
            f"{height} pixels. Is it the K of another size? If not, give (K, D, (width, height))."
        )
    lens = tuple(np.pad(d[:5], (0, 5 - d[:5].size)).tolist())
    distortion = {"model": "brown_conrady" if any(lens) else "pinhole", "coeffs": lens}
    return {"width": width, "height": height, "fx": fx, "fy": fy, "cx": cx, "cy": cy, **distortion}


def _numbers(values: Any, name: str) -> npt.NDArray[np.float64]:
    try:
        return np.ravel(np.asarray(values, np.float64))
    except (TypeError, ValueError) as error:
        raise ValueError(f"camera: expected numbers as {name}, got {values!r:.100}.") from error
