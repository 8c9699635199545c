"""A first HSV range from one pixel on the object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.image.segmentation import HUES, HSVRange, Segmentation

_PATCH: Final = 3
_COLOURFUL: Final = 60  # saturation from which hue means something
_HUE_REACH: Final = 12
_MAX_SHARE: Final = 0.5


def propose_hsv(rgb: npt.NDArray[np.uint8], pixel: tuple[float, float]) -> HSVRange:
    """Propose the HSV range of the object under a pixel.

    Pixels that resemble the picked one and are connected with it are gathered, and the range is widened to hold
    nearly all of them: by hue where the object has a colour, by saturation and brightness where it is gray.

    Args:
        rgb: ``(H, W, 3)`` uint8, RGB.
        pixel: (u, v) on the object.

    Raises:
        ValueError: The pixel lies outside the image, or half of the image looks like it.
    """
    height, width = rgb.shape[:2]
    u, v = round(pixel[0]), round(pixel[1])
    if not (0 <= u < width and 0 <= v < height):
        raise ValueError(f"pick: pixel ({u}, {v}) lies outside the image of {width} x {height} pixels.")
    hsv = cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV)
    patch = hsv[max(v - _PATCH, 0) : v + _PATCH + 1, max(u - _PATCH, 0) : u + _PATCH + 1].reshape(-1, 3)
    like = patch[np.linalg.norm(patch.astype(float) - hsv[v, u], axis=1) < 60]
    hue, saturation, value = _middle_hue(like[:, 0]), *(float(np.median(like[:, i])) for i in (1, 2))
    turned = (hsv[..., 0].astype(np.int16) - round(hue) + HUES // 2) % HUES - HUES // 2
    if saturation >= _COLOURFUL:
        rule = (np.abs(turned) <= _HUE_REACH) & (hsv[..., 1] >= 0.5 * saturation) & (hsv[..., 2] >= 0.35 * value)
    else:
        rule = (hsv[..., 1] <= saturation + 40) & (np.abs(hsv[..., 2] - value) <= 35)
    object_mask = _component_at(rule, u, v)
    if object_mask.mean() > _MAX_SHARE:
        raise ValueError(
            f"pick: {object_mask.mean():.0%} of the image looks like pixel ({u}, {v}); pick a pixel on the object, "
            "not on the background, or give the range with --hsv."
        )
    return _range_of(hsv[object_mask], turned[object_mask], hue, colourful=saturation >= _COLOURFUL)


def _range_of(hsv: npt.NDArray[Any], turned: npt.NDArray[Any], hue: float, *, colourful: bool) -> HSVRange:
    low, high = np.percentile(hsv[:, 1:], (1, 99), axis=0)
    if not colourful:
        bounds = np.clip([low - 10, high + 15], 0, 255).astype(int)
        return HSVRange((0, int(bounds[0, 0]), int(bounds[0, 1])), (HUES - 1, int(bounds[1, 0]), int(bounds[1, 1])))
    near, far = np.percentile(turned, (1, 99))
    first, last = (round(hue + near) - 5) % HUES, (round(hue + far) + 5) % HUES
    saturation, value = np.clip(low * (0.85, 0.7), 20, 255).astype(int)
    return HSVRange((int(first), int(saturation), int(value)), (int(last), 255, 255))


def _middle_hue(hues: npt.NDArray[Any]) -> float:
    """Return the mean on the circle of hues."""
    angle = np.angle(np.mean(np.exp(2j * np.pi * hues.astype(float) / HUES)))
    return float(angle / (2 * np.pi) * HUES % HUES)


def _component_at(rule: npt.NDArray[np.bool_], u: int, v: int) -> npt.NDArray[np.bool_]:
    """Return the part of a mask that is connected with a pixel, small holes and cracks closed."""
    square = np.ones((3, 3), np.uint8)
    labels = np.asarray(cv2.connectedComponents(cv2.morphologyEx(rule.view(np.uint8), cv2.MORPH_CLOSE, square))[1])
    return (labels == labels[v, u]) & rule if labels[v, u] else rule


@dataclass(frozen=True)
class Proposal:
    """A segmentation that fits clicks on an image.

    Attributes:
        rule: The pixel rule, with its clean-up.
        mask: ``(H, W)`` bool, the object that was clicked in this image.
        text: What was found, in plain words.
    """

    rule: Segmentation
    mask: npt.NDArray[np.bool_]
    text: str


def propose_segmentation(
    rgb: npt.NDArray[np.uint8],
    picks: Sequence[tuple[float, float]],
    nots: Sequence[tuple[float, float]] = (),
    depth: npt.NDArray[Any] | None = None,
) -> Proposal:
    """Propose the segmentation of the object under some pixels.

    Args:
        rgb: ``(H, W, 3)`` uint8, RGB.
        picks: (u, v) on the object, at least one.
        nots: (u, v) that are not on the object.
        depth: ``(H, W)``, as a ``Frame`` takes it, aligned to rgb.

    Raises:
        ValueError: A pixel lies outside the image, or no rule separates the object from its surroundings.
    """
    rule = propose_hsv(rgb, picks[0])
    u, v = round(picks[0][0]), round(picks[0][1])
    mask = _component_at(rule.matches(rgb) > 0, u, v)
    return Proposal(rule, mask, f"{np.count_nonzero(mask)} pixels have the colour of ({u}, {v}).")
