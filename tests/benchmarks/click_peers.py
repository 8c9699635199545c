"""What clicks are compared with: a range of hues around one pixel, and GrabCut of OpenCV."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.image.click_regions import connected
from shape_obs.image.segmentation import HUES, HSVRange

Pixel = tuple[float, float]
Mask = npt.NDArray[np.bool_]
Image = npt.NDArray[np.uint8]

_COLOURFUL: Final = 60  # saturation from which hue means something
_REACH: Final = 12  # of hues
_ROUNDS: Final = 5  # of GrabCut


def hsv_range(rgb: Image, pixel: Pixel) -> HSVRange:
    """Return the range that holds nearly all pixels that are connected with a pixel and resemble it.

    By hue where the pixel has a colour, by saturation and brightness where it is gray.
    """
    u, v = round(pixel[0]), round(pixel[1])
    hsv = cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV)
    patch = hsv[max(v - 3, 0) : v + 4, max(u - 3, 0) : u + 4].reshape(-1, 3)
    like = patch[np.linalg.norm(patch.astype(float) - hsv[v, u], axis=1) < 60]
    angle = np.angle(np.mean(np.exp(2j * np.pi * like[:, 0] / HUES)))
    hue, saturation, value = float(angle / (2 * np.pi) * HUES % HUES), *np.median(like[:, 1:], axis=0)
    turned = (hsv[..., 0].astype(np.int16) - round(hue) + HUES // 2) % HUES - HUES // 2
    colourful = saturation >= _COLOURFUL
    if colourful:
        rule = (np.abs(turned) <= _REACH) & (hsv[..., 1] >= 0.5 * saturation) & (hsv[..., 2] >= 0.35 * value)
    else:
        rule = (hsv[..., 1] <= saturation + 40) & (np.abs(hsv[..., 2] - value) <= 35)
    piece = connected(np.asarray(rule), (u, v)) if rule[v, u] else rule
    low, high = np.percentile(hsv[piece][:, 1:], (1, 99), axis=0)
    if not colourful:
        (s0, v0), (s1, v1) = np.clip([low - 10, high + 15], 0, 255).astype(int).tolist()
        return HSVRange((0, s0, v0), (HUES - 1, s1, v1))
    near, far = np.percentile(turned[piece], (1, 99))
    least = np.clip(low * (0.85, 0.7), 20, 255).astype(int).tolist()
    return HSVRange(((round(hue + near) - 5) % HUES, *least), ((round(hue + far) + 5) % HUES, 255, 255))


def grab_cut(rgb: Image, picks: Sequence[Pixel], nots: Sequence[Pixel]) -> Mask:
    """Return what GrabCut finds if a disc around each click is certain: Rother, Kolmogorov and Blake, 2004."""
    labels = np.full(rgb.shape[:2], cv2.GC_PR_BGD, np.uint8)
    for pixels, label in ((nots, cv2.GC_BGD), (picks, cv2.GC_FGD)):
        for u, v in pixels:
            cv2.circle(labels, (round(u), round(v)), 2, label, -1)
    models: list[Any] = [np.zeros((1, 65)), np.zeros((1, 65))]
    cv2.setRNGSeed(0)
    cv2.grabCut(np.ascontiguousarray(rgb[..., ::-1]), labels, None, *models, _ROUNDS, cv2.GC_INIT_WITH_MASK)  # type: ignore[arg-type]
    return (labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)
