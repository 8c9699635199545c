"""The pictures of a page: the image with mask and points, and what each stage made of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.drawing import draw_detection
from shape_obs.image.roi import Whole
from shape_obs.shape import Detection
from shape_obs.tuner.result import Result

Image = npt.NDArray[np.uint8]

TINT: Final = (255, 64, 180)
BORDER: Final = (30, 136, 229)
_WIDEST: Final = 1280  # pixels of a picture: what a page shows of a large photo
_NARROWEST: Final = 480
_QUALITY: Final = 85


def overlay(result: Result) -> Image:
    """Return the picture of a page: the image, its mask tinted and outlined, the numbered points, the area.

    A large image is made smaller, and a small one is enlarged, so that the numbers can be read.
    """
    picture, mask, scale = result.picture(), result.mask, scale_of(result.size)
    size = (round(picture.shape[1] * scale), round(picture.shape[0] * scale))
    if scale != 1:
        how = cv2.INTER_AREA if scale < 1 else cv2.INTER_NEAREST
        picture = np.asarray(cv2.resize(picture, size, interpolation=how), np.uint8)
        mask = np.asarray(cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST), np.uint8)
    drawn = tinted(picture, mask)
    _shade_outside(drawn, result, scale)
    if result.detection is not None:
        drawn = draw_detection(drawn, scaled(result.detection, scale))
    return drawn


def scale_of(size: tuple[int, int]) -> float:
    """Return by how much the picture of an image of ``(H, W)`` is larger than the image."""
    width = max(size[1], 1)
    if width > _WIDEST:
        return _WIDEST / width
    return float(-(-_NARROWEST // width)) if width < _NARROWEST else 1.0


def tinted(picture: Image, mask: Image) -> Image:
    """Return a copy of a picture whose mask is tinted and outlined."""
    drawn = picture.copy()
    inside = mask > 0
    drawn[inside] = (0.55 * drawn[inside] + 0.45 * np.array(TINT)).astype(np.uint8)
    outlines = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0]
    cv2.drawContours(drawn, outlines, -1, TINT, 1)
    return drawn


def encode(picture: Image) -> bytes:
    """Return an RGB picture as a JPEG."""
    done, data = cv2.imencode(".jpg", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    assert done
    return data.tobytes()


def _shade_outside(picture: Image, result: Result, scale: float) -> None:
    """Darken what lies outside the area that is searched, and draw its border, in place."""
    if result.roi is None or isinstance(result.roi, Whole):
        return
    window = result.roi.window(result.size)
    inside = result.roi.blank(np.full((window.height, window.width), 255, np.uint8), window)
    area = np.zeros(result.size, np.uint8)
    area[window.slices] = inside
    if scale != 1:
        area = np.asarray(cv2.resize(area, picture.shape[1::-1], interpolation=cv2.INTER_NEAREST), np.uint8)
    outside = area == 0
    picture[outside] = picture[outside] // 2
    cv2.drawContours(picture, cv2.findContours(area, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0], -1, BORDER, 2)


def scaled(detection: Detection, scale: float) -> Detection:
    """Return a detection in the pixels of the picture."""
    if scale == 1:
        return detection
    shapes = tuple(
        shape if shape.points2d is None else replace(shape, points2d=_place(shape.points2d, scale))
        for shape in detection
    )
    crossings = tuple(
        each._replace(pixel=tuple(_place(np.array(each.pixel), scale).tolist())) for each in detection.crossings
    )
    return replace(detection, shapes=shapes, crossings=crossings)


def _place(points: npt.NDArray[Any], scale: float) -> npt.NDArray[np.float32]:
    return ((points + 0.5) * scale - 0.5).astype(np.float32)
