"""Textures without OpenGL: sampled as it does, repeated, linear between texels and between sizes of the picture."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Texture:
    """A picture and its halves, quarters and so on, of which those nearest to the size seen are mixed.

    Args:
        picture: (H, W, 3) uint8.
    """

    def __init__(self, picture: NDArray[np.uint8]) -> None:
        self._sizes = [picture]
        while min(self._sizes[-1].shape[:2]) > 1:
            last = self._sizes[-1]
            self._sizes.append(cv2.resize(last, (last.shape[1] // 2, last.shape[0] // 2), interpolation=cv2.INTER_AREA))

    @classmethod
    def of(cls, model: Any, material: int) -> Texture | None:
        """The texture of a model's material; None where there is no material, or one without."""
        if material < 0:
            return None
        index = int(model.mat_texid[material].max())  # the one role that it has
        if index < 0:
            return None
        height, width, start = (int(field[index]) for field in (model.tex_height, model.tex_width, model.tex_adr))
        return cls(model.tex_data[start : start + 3 * height * width].reshape(height, width, 3).copy())

    @property
    def is_white(self) -> bool:
        """Whether it leaves the colours of what it covers as they are."""
        return bool(self._sizes[0].min() == 255)

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in texels."""
        return self._sizes[0].shape[0], self._sizes[0].shape[1]

    def sample(self, places: NDArray[Any], fineness: NDArray[Any] | float) -> NDArray[np.float32]:
        """Colours of places.

        Args:
            places: (..., 2) from the picture's upper left corner to the right and down, in parts of it; any numbers.
            fineness: (...) how many texels there are to a pixel.

        Returns:
            (..., 3) colours, 0 ... 1.
        """
        level = np.clip(np.log2(np.maximum(fineness, 1e-6)), 0, len(self._sizes) - 1)
        flat = np.asarray(places, np.float32).reshape(-1, 2)
        level = np.broadcast_to(level, np.shape(places)[:-1]).reshape(-1)
        lower = np.floor(level).astype(int)
        out = np.empty((len(flat), 3), np.float32)
        for i in np.unique(lower):
            here = lower == i
            more = (level[here] - i).astype(np.float32)[:, None]
            fine = self._linear(i, flat[here])
            out[here] = fine if not more.any() else (1 - more) * fine + more * self._linear(i + 1, flat[here])
        return out.reshape(*np.shape(places)[:-1], 3) / np.float32(255)

    def _linear(self, size: int, places: NDArray[np.float32]) -> NDArray[np.float32]:
        """(P, 3) colours 0 ... 255 from one size of the picture."""
        picture = self._sizes[min(size, len(self._sizes) - 1)]
        height, width = picture.shape[:2]
        at = places * (width, height) - 0.5
        left, top = np.floor(at).astype(int).T
        (right, down), picture = (at - np.floor(at)).astype(np.float32).T[..., None], picture.astype(np.float32)
        rows, columns = (top % height, (top + 1) % height), (left % width, (left + 1) % width)
        upper = (1 - right) * picture[rows[0], columns[0]] + right * picture[rows[0], columns[1]]
        lower = (1 - right) * picture[rows[1], columns[0]] + right * picture[rows[1], columns[1]]
        return (1 - down) * upper + down * lower
