"""The pictures of a page: the image with mask and points, and what each stage made of it."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.drawing import Image, draw_curve, draw_over, draw_text, enlarged, mark_size, wrapped
from shape_obs.frame import Frame
from shape_obs.geometry.observed import Samples
from shape_obs.image.region import Region
from shape_obs.image.roi import ROI, Whole
from shape_obs.tracking.clock import Clock
from shape_obs.tracking.predict import Fit
from shape_obs.tracking.scene import Scene
from shape_obs.tuner.result import Result

#: Names of the stages, with what each picture shows.
STAGES: Final = {
    "area": "1. Area: where is it looked for",
    "mask": "2. Mask: which pixels match",
    "samples": "3. Samples: pixels put together in cells",
    "nodes": "4. Nodes: the form fitted to the samples",
    "points": "5. Points: N points in order",
}
_TINT: Final = (255, 64, 180)
_BORDER: Final = (30, 136, 229)
_PAPER: Final = (250, 250, 250)
_PALE: Final = (176, 190, 209)
_LINE: Final = (90, 105, 125)
_WIDEST: Final = 1280  # pixels of a picture: what a page shows of a large photo
_NARROWEST: Final = 480
_STAGE: Final = 480  # pixels: the width of a stage's picture
_QUALITY: Final = 85


def overlay(result: Result) -> Image:
    """Return the picture of a page: the image, its mask tinted and outlined, the numbered points, the area.

    A large image is made smaller, and a small one is enlarged, so that the numbers can be read.
    """
    picture, mask, scale = result.picture(), result.mask, scale_of(result.size)
    if scale != 1:
        size = (round(picture.shape[1] * scale), round(picture.shape[0] * scale))
        picture, mask = _resized(picture, size, cv2.INTER_NEAREST), _resized(mask, size)
    drawn, marks = picture.copy(), mark_size(picture)
    inside = mask > 0
    drawn[inside] = (0.55 * drawn[inside] + 0.45 * np.array(_TINT)).astype(np.uint8)
    cv2.drawContours(drawn, cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0], -1, _TINT, round(marks))
    if result.roi is not None and not isinstance(result.roi, Whole):
        drawn = _shaded(drawn, result.roi, result.size, darker=2)
    if result.detection is not None:
        draw_over(drawn, result.detection, scale, marks)
    return drawn


def scale_of(size: tuple[int, int]) -> float:
    """Return by how much the picture of an image of ``(H, W)`` is larger than the image."""
    width = max(size[1], 1)
    if width > _WIDEST:
        return _WIDEST / width
    return float(-(-_NARROWEST // width)) if width < _NARROWEST else 1.0


def encode(picture: Image) -> bytes:
    """Return an RGB picture as a JPEG."""
    done, data = cv2.imencode(".jpg", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    assert done
    return data.tobytes()


def stage_picture(result: Result, stage: str) -> Image:
    """Return the picture of a stage, for the first shape of a result.

    The samples and nodes are those of a fit without a track, as in a first frame.

    Args:
        result: What was found.
        stage: A key of ``STAGES``.
    """
    scale = _STAGE / max(result.size[1], 1)
    picture = result.picture()
    picture = _resized(picture, (_STAGE, max(round(picture.shape[0] * scale), 1)), cv2.INTER_LINEAR)
    spec = result.config.filled()[0]
    if stage == "area":
        if result.roi is None:
            return _blank(picture, "the area is not known in this frame")
        return _shaded(picture, result.roi, result.size, darker=3)
    if result.roi is None or spec.segmentation is None or result.error:
        return _blank(picture, result.error or "nothing is looked for yet")
    region = result.regions[spec.segmentation]
    if stage == "mask":
        return _pale(picture, region, result.size)
    if stage == "points":
        assert result.detection is not None
        draw_over(picture, result.detection, scale)
        return picture
    if region.refusal:
        return _blank(picture, region.refusal)
    drawn = _pale(picture, region, result.size)
    if stage == "samples":
        _draw_samples(drawn, region.gather(max(region.width / 3, 1.0)), scale)
        return drawn
    found = spec.fit(region, None, None, Scene.in_image(Frame(), Clock(), result.size, result.roi.window(result.size)))
    if found.track is None:
        return _blank(picture, found.reason or "no form was found")
    _draw_nodes(drawn, found, scale)
    return drawn


def _resized(picture: Image, size: tuple[int, int], larger: int = cv2.INTER_NEAREST) -> Image:
    """Return a picture in another size (width, height); a mask, which has no colours, is not averaged."""
    how = cv2.INTER_AREA if picture.ndim == 3 and size[0] < picture.shape[1] else larger
    return np.array(cv2.resize(picture, size, interpolation=how), np.uint8)


def _shaded(picture: Image, roi: ROI, size: tuple[int, int], darker: int) -> Image:
    """Return a picture of an image of ``(H, W)``, dark outside the area that is searched, with the area's border.

    Args:
        picture: ``(h, w, 3)``.
        roi: The area.
        size: Of the image.
        darker: Divides what is outside; also the thickness of the border.
    """
    window = roi.window(size)
    area = np.zeros(size, np.uint8)
    area[window.slices] = roi.blank(np.full((window.height, window.width), 255, np.uint8), window)
    area = _resized(area, picture.shape[1::-1])
    drawn = np.where(area[..., None] > 0, picture, picture // darker).astype(np.uint8)
    cv2.drawContours(drawn, cv2.findContours(area, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0], -1, _BORDER, darker)
    return drawn


def _pale(picture: Image, region: Region, size: tuple[int, int]) -> Image:
    """Return the mask in a pale colour on paper."""
    mask = np.zeros(size, np.uint8)
    mask[region.window.slices] = region.mask
    inside = _resized(mask, picture.shape[1::-1])[..., None] > 0
    return np.where(inside, np.array(_PALE), np.array(_PAPER)).astype(np.uint8)


def _draw_samples(picture: Image, samples: Samples, scale: float) -> None:
    """Draw each sample as a dot as large as its weight, in place."""
    for point, weight in zip(enlarged(samples.points, scale), samples.weight, strict=True):
        _dot(picture, point, max(0.35 * scale * weight**0.5, 1.2), _TINT)


def _draw_nodes(picture: Image, found: Fit, scale: float) -> None:
    """Draw the nodes of a fit and the lines between neighbours, in place."""
    assert found.track is not None
    nodes = enlarged(found.track.nodes, scale)
    for first, second in found.track.topology.edges():
        draw_curve(picture, nodes[[first, second]], _LINE, thickness=2)
    for node in nodes:
        _dot(picture, node, 4.0, _BORDER)


def _dot(picture: Image, point: npt.NDArray[np.float64], radius: float, colour: tuple[int, int, int]) -> None:
    centre = round(point[0] * 16), round(point[1] * 16)
    cv2.circle(picture, centre, round(radius * 16), colour, -1, cv2.LINE_AA, 4)


def _blank(picture: Image, text: str) -> Image:
    """Return paper with a reason on it, broken into lines."""
    paper = np.full_like(picture, 245)
    for i, line in enumerate(wrapped(text, paper.shape[1] - 32)):
        draw_text(paper, line, (16, 32 + 20 * i))
    return paper
