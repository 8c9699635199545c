"""Textures without OpenGL: sampled as it does, repeated, linear between texels and between sizes of the picture."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

_ROW = 1024


class Texture:
    """A picture and its halves, quarters and so on, of which those nearest to the size seen are mixed.

    Args:
        picture: (H, W, 3) uint8.
    """

    def __init__(self, picture: NDArray[np.uint8]) -> None:
        self._sizes: list[NDArray[Any]] = [picture]
        while max(self._sizes[-1].shape[:2]) > 1:
            last = self._sizes[-1]
            width, height = (max(side // 2, 1) for side in last.shape[1::-1])
            self._sizes.append(cv2.resize(last, (width, height), interpolation=cv2.INTER_AREA))

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

    def sample(self, places: NDArray[Any], fineness: NDArray[Any] | float) -> NDArray[Any]:
        """Colours of places.

        Args:
            places: (..., 2) from the picture's upper left corner to the right and down, in parts of it; any numbers.
            fineness: (...) how many texels there are to a pixel.

        Returns:
            (..., 3) float32 colours, 0 ... 1.
        """
        # OpenCV draws pictures, and no side of one may be longer than 32766: the places are laid out in rows
        count = int(np.prod(np.shape(places)[:-1]))
        padded = np.zeros((-(-count // _ROW) * _ROW, 2), np.float32)
        padded[:count] = np.reshape(places, (-1, 2))
        level = np.zeros(len(padded), np.float32)
        level[:count] = np.broadcast_to(np.log2(np.maximum(fineness, 1e-6)), np.shape(places)[:-1]).ravel()
        at, level = padded.reshape(-1, _ROW, 2), np.clip(level, 0, len(self._sizes) - 1).reshape(-1, _ROW, 1)
        out = np.zeros((*at.shape[:2], 3), np.float32)
        for i in range(int(level.min()), int(np.ceil(level.max())) + 1):
            picture = self._sizes[i]
            texels = at * np.array(picture.shape[1::-1], np.float32) - np.float32(0.5)
            seen = cv2.remap(picture, texels, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)  # type: ignore[call-overload]
            out += np.maximum(1 - np.abs(level - i), 0) * seen
        return (out / np.float32(255)).reshape(-1, 3)[:count].reshape(*np.shape(places)[:-1], 3)
