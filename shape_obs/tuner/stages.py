"""What each stage made of a frame, as pictures: area, mask, samples, nodes, points."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.configurations.base import Configuration, Scene
from shape_obs.drawing import draw_curve, draw_detection
from shape_obs.geometry.observed import Samples
from shape_obs.image.region import Region
from shape_obs.tracking.prediction import Fit
from shape_obs.tuner.pictures import BORDER, TINT, Image, scaled
from shape_obs.tuner.result import Result

#: Names of the stages, with what each picture shows.
STAGES: Final = {
    "area": "1. Area: where is it looked for",
    "mask": "2. Mask: which pixels match",
    "samples": "3. Samples: pixels put together in cells",
    "nodes": "4. Nodes: the form fitted to the samples",
    "points": "5. Points: N points in order",
}
_PAPER: Final = (250, 250, 250)
_PALE: Final = (176, 190, 209)
_LINE: Final = (90, 105, 125)
_WIDTH: Final = 480
_ANTIALIASED: Final = cv2.LINE_AA


def stage_picture(result: Result, stage: str) -> Image:
    """Return the picture of a stage, for the first shape of a result.

    The samples and nodes are those of a fit without a track, as in a first frame.

    Args:
        result: What was found.
        stage: A key of ``STAGES``.
    """
    scale = _WIDTH / max(result.size[1], 1)
    picture = _resized(result.picture(), scale)
    spec = result.config.filled()[0]
    if stage == "area":
        return _area(picture, result, scale)
    if result.roi is None or spec.segmentation is None or result.error:
        return _blank(picture, result.error or "nothing is looked for yet")
    region = result.regions[spec.segmentation]
    if stage == "mask":
        return _pale(picture, region, result.size)
    if stage == "points":
        assert result.detection is not None
        return draw_detection(picture, scaled(result.detection, scale))
    if region.refusal:
        return _blank(picture, region.refusal)
    drawn = _pale(picture, region, result.size)
    if stage == "samples":
        _draw_samples(drawn, region.gather(max(region.width / 3, 1.0)), scale)
        return drawn
    found = spec.fit(region, None, None, Scene(result.roi.window(result.size)))
    if found.nodes is None or found.topology is None:
        return _blank(picture, found.reason or "no form was found")
    _draw_nodes(drawn, found, spec, scale)
    return drawn


def _resized(picture: Image, scale: float) -> Image:
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    size = (_WIDTH, max(round(picture.shape[0] * scale), 1))
    return np.asarray(cv2.resize(picture, size, interpolation=how), np.uint8)


def _area(picture: Image, result: Result, scale: float) -> Image:
    if result.roi is None:
        return _blank(picture, "the area is not known in this frame")
    window = result.roi.window(result.size)
    area = np.zeros(result.size, np.uint8)
    area[window.slices] = result.roi.blank(np.full((window.height, window.width), 255, np.uint8), window)
    area = np.asarray(cv2.resize(area, picture.shape[1::-1], interpolation=cv2.INTER_NEAREST), np.uint8)
    drawn = np.where(area[..., None] > 0, picture, picture // 3).astype(np.uint8)
    cv2.drawContours(drawn, cv2.findContours(area, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0], -1, BORDER, 3)
    return drawn


def _pale(picture: Image, region: Region, size: tuple[int, int]) -> Image:
    """Return the mask in a pale colour on paper."""
    mask = np.zeros(size, np.uint8)
    mask[region.window.slices] = region.mask
    mask = np.asarray(cv2.resize(mask, picture.shape[1::-1], interpolation=cv2.INTER_NEAREST), np.uint8)
    return np.where(mask[..., None] > 0, np.array(_PALE), np.array(_PAPER)).astype(np.uint8)


def _draw_samples(picture: Image, samples: Samples, scale: float) -> None:
    """Draw each sample as a dot as large as its weight, in place."""
    for point, weight in zip(_place(samples.points, scale), samples.weight, strict=True):
        radius = max(0.35 * scale * weight**0.5, 1.2)
        cv2.circle(picture, _fixed(point), round(radius * 16), TINT, -1, _ANTIALIASED, 4)


def _draw_nodes(picture: Image, found: Fit, spec: Configuration, scale: float) -> None:
    """Draw the nodes of a fit and the lines between neighbours, in place."""
    assert found.nodes is not None
    assert found.topology is not None
    nodes = _place(found.nodes, scale)
    for first, second in found.topology.edges():
        draw_curve(picture, nodes[[first, second]], _LINE, thickness=2)
    for node in nodes:
        cv2.circle(picture, _fixed(node), 4 * 16, BORDER, -1, _ANTIALIASED, 4)


def _blank(picture: Image, text: str) -> Image:
    """Return paper with a reason on it, broken into lines."""
    from shape_obs.drawing import draw_text

    paper = np.full_like(picture, 245)
    words, lines = text.split(), [""]
    for word in words:
        if len(lines[-1]) + len(word) > 52:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    for i, line in enumerate(lines):
        draw_text(paper, line, (16, 32 + 20 * i))
    return paper


def _place(points: npt.NDArray[np.floating], scale: float) -> npt.NDArray[np.float64]:
    return (np.asarray(points, np.float64) + 0.5) * scale - 0.5


def _fixed(point: npt.NDArray[np.float64]) -> tuple[int, int]:
    return round(point[0] * 16), round(point[1] * 16)
