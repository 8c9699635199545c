"""What a click on a photo may mean: regions of one colour around it, and how clearly their borders stand out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.frame import depth_in_metres
from shape_obs.image.clicked_colours import as_lab, cells_of, colours_of

Mask = npt.NDArray[np.bool_]
Pixel = tuple[int, int]

_SQUARE: Final = np.ones((3, 3), np.uint8)
_TOLERANCES: Final = (4, 6, 8, 10, 13, 16, 20, 25, 31)  # distance of colours in Lab
_LIGHT_WEIGHTS: Final = (0.12, 1.0)  # of squared differences of lightness: light and shadow differ in it most
_SMALLEST, _LARGEST, _GROWN = 15, 0.6, 1.05  # pixels; share of the image; by how much the next region must be larger
_BORDER: Final = 2000  # pixels of a border that are looked at
_STEP: Final = 0.006, 0.015  # metres, and share of the distance: a change of depth that separates things


class Photo:
    """A photo in the form in which clicks are interpreted.

    Args:
        rgb: ``(H, W, 3)`` uint8.
        depth: ``(H, W)`` as a ``Frame`` has it, or None.

    Attributes:
        lab: ``(H, W, 3)`` float32, CIE Lab.
        smooth: The same without the noise of single pixels.
        cells: The cells of Lab that occur, and of each pixel its place among them, ``(H, W)``.
        steps: ``(H, W)`` bool, where depth changes abruptly; None without depth.
    """

    def __init__(self, rgb: npt.NDArray[np.uint8], depth: npt.NDArray[Any] | None) -> None:
        self.rgb, self.shape = rgb, rgb.shape[:2]
        stored = cv2.cvtColor(rgb, cv2.COLOR_RGB2LAB)
        self.lab, self.smooth = as_lab(stored), as_lab(np.asarray(cv2.medianBlur(stored, 3)))
        cells = cells_of(rgb)
        occurring, places = np.unique(cells, return_inverse=True)
        self.cells = occurring, places.reshape(cells.shape)
        self.colours = colours_of(occurring)
        self.steps = None if depth is None else _depth_steps(depth)
        self.rng = np.random.default_rng(0)  # samples are the same for the same clicks

    def sample(self, mask: Mask, count: int) -> npt.NDArray[np.float64]:
        """Return the smoothed colours of at most ``count`` pixels of a mask, ``(K, 3)``."""
        chosen = np.flatnonzero(mask)
        if len(chosen) > count:
            chosen = self.rng.choice(chosen, count, replace=False)
        return self.smooth.reshape(-1, 3)[chosen].astype(np.float64)


@dataclass(frozen=True, eq=False)
class Region:
    """Connected pixels of about one colour.

    Args:
        mask: ``(H, W)`` bool.
        contrast: By how much colours change across most of its border, in Lab.
    """

    mask: Mask
    contrast: float


def regions_at(photo: Photo, pixel: Pixel) -> list[Region]:
    """Return the regions around a pixel for several tolerances, the one with the clearest border first."""
    u, v = pixel
    square = np.s_[max(v - 1, 0) : v + 2, max(u - 1, 0) : u + 2]
    colour = np.median(photo.smooth[square].reshape(-1, 3), axis=0)
    difference = (photo.smooth - colour.astype(np.float32)) ** 2
    found = []
    for weight in _LIGHT_WEIGHTS:
        distance = weight * difference[..., 0] + difference[..., 1] + difference[..., 2]
        last = 0.0
        for tolerance in _TOLERANCES:
            like = distance <= tolerance**2
            like[square] |= distance[square] <= (2 * tolerance) ** 2
            if photo.steps is not None and not photo.steps[square].any():
                like &= ~photo.steps
            mask = connected(like, pixel)
            area = np.count_nonzero(mask)
            if max(_SMALLEST, _GROWN * last) <= area <= _LARGEST * mask.size:
                last = area
                found.append(Region(mask, float(np.percentile(border_changes(photo, mask), 25))))
    return sorted(found, key=lambda region: -region.contrast)


def connected(mask: Mask, pixel: Pixel) -> Mask:
    """Return the pixels of a mask that are connected with one of them; none if that is not in the mask."""
    u, v = pixel
    if not mask[v, u]:
        return np.zeros_like(mask)
    labels = np.asarray(cv2.connectedComponents(mask.view(np.uint8), connectivity=8)[1])
    return labels == labels[v, u]


def around(mask: Mask, pixel: Pixel) -> int:
    """Return how many pixels of a mask lie in the 3 x 3 pixels around one."""
    u, v = pixel
    return int(np.count_nonzero(mask[max(v - 1, 0) : v + 2, max(u - 1, 0) : u + 2]))


def core(mask: Mask) -> Mask:
    """Return a mask without its border, where colours are mixed; all of it where little would be left."""
    inner = np.asarray(cv2.erode(mask.view(np.uint8), _SQUARE)).view(np.bool_)
    return inner if np.count_nonzero(inner) >= 0.3 * np.count_nonzero(mask) else mask


def border_changes(
    photo: Photo, mask: Mask, inside: float = -1.0, outside: float = 2.0, *, smooth: bool = True
) -> npt.NDArray[np.float32]:
    """Return by how much the colour changes across the border of a mask, at many places of it.

    Args:
        photo: The photo.
        mask: ``(H, W)`` bool.
        inside: Where to look within the mask, pixels from its outermost pixels along the outward normal.
        outside: The same for the other side.
        smooth: Whether to look at the smoothed photo.

    Returns:
        ``(K,)`` distances in Lab; a single 0 where the mask has hardly a border.
    """
    if not mask.any():
        return np.zeros(1, np.float32)
    window = box(mask, 4)
    part = np.ascontiguousarray(mask[window]).view(np.uint8)
    lab = np.ascontiguousarray((photo.smooth if smooth else photo.lab)[window])
    inner = np.asarray(cv2.erode(part, _SQUARE, borderType=cv2.BORDER_REPLICATE))
    rows, columns = np.nonzero(part > inner)
    if len(rows) < 8:
        return np.zeros(1, np.float32)
    if len(rows) > _BORDER:
        some = photo.rng.choice(len(rows), _BORDER, replace=False)
        rows, columns = rows[some], columns[some]
    soft = cv2.GaussianBlur(part.astype(np.float32), (0, 0), 1.2)
    across = np.asarray(cv2.Sobel(soft, cv2.CV_32F, 1, 0), np.float32)[rows, columns]
    down = np.asarray(cv2.Sobel(soft, cv2.CV_32F, 0, 1), np.float32)[rows, columns]
    normal = -np.stack([across, down]) / np.maximum(np.hypot(across, down), 1e-9)

    def at(distance: float) -> npt.NDArray[np.float32]:
        u, v = (np.stack([columns, rows]) + distance * normal).astype(np.float32)
        looked_up = cv2.remap(lab, u[None], v[None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(looked_up, np.float32)[0]

    return np.linalg.norm(at(outside) - at(inside), axis=1)


def box(mask: Mask, pad: int) -> tuple[slice, slice]:
    """Return the rows and columns of a mask that is not empty, with ``pad`` more on each side."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return slice(max(rows[0] - pad, 0), rows[-1] + pad + 1), slice(max(columns[0] - pad, 0), columns[-1] + pad + 1)


def _depth_steps(depth: npt.NDArray[Any]) -> Mask:
    """Return where depth changes abruptly between neighbours; where there is none it is not known to."""
    metres = depth_in_metres(depth).astype(np.float32)
    unknown = ~np.isfinite(metres)
    high = np.asarray(cv2.dilate(np.where(unknown, -np.inf, metres).astype(np.float32), _SQUARE))
    low = np.asarray(cv2.erode(np.where(unknown, np.inf, metres).astype(np.float32), _SQUARE))
    with np.errstate(invalid="ignore"):
        return (high - low > np.maximum(_STEP[0], _STEP[1] * low)) & ~unknown
