"""Encode animated GIFs that are small enough for a web page or a chat."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from PIL import Image as Pillow

from shape_obs.drawing import Image

#: Largest width or height in pixels; larger pictures are reduced.
_LARGEST: Final = 640
#: Largest number of pictures per second. Durations are hundredths of a second, and browsers slow down short ones.
_FASTEST: Final = 12.5
#: Largest number of pictures, which are kept in memory until the end.
_MOST: Final = 400
#: Number of pictures from which colours are chosen; and of these colours. The other 64 of a GIF form a cube, so that no
#: later colour is far from all of them.
_EARLY: Final = 24
_CHOSEN: Final = 192
_CUBE: Final = (0, 85, 170, 255)


class GifEncoder:
    """Encode a GIF that is played at the speed of the frames and repeats for ever.

    Pictures are left out so that at most 12.5 remain per second and 400 in all: a long GIF has fewer pictures per
    second. All share one palette, chosen from the first 24 pictures, without dithering: still parts do not flicker and
    take no space.

    Args:
        file: The file to write.
        size: (width, height) of the pictures in pixels.
        fps: Frames per second of the pictures that are added.
    """

    def __init__(self, file: Path, size: tuple[int, int], fps: float) -> None:
        self._file, self._fps = file, fps
        scale = min(1.0, _LARGEST / max(size))
        self._size = max(1, round(size[0] * scale)), max(1, round(size[1] * scale))
        self._every = max(1, int(np.ceil(fps / _FASTEST - 1e-6)))
        self._count = 0
        self._palette: Pillow.Image | None = None
        self._early: list[Pillow.Image] = []
        self._kept: list[Pillow.Image] = []

    def add(self, picture: Image) -> None:
        """Add an RGB picture ``(H, W, 3)`` uint8."""
        if self._count % self._every == 0:
            small = Pillow.fromarray(np.asarray(cv2.resize(picture, self._size, interpolation=cv2.INTER_AREA)))
            self._early.append(small)
            if self._palette is not None or len(self._early) == _EARLY:
                self._reduce()
            if len(self._kept) > _MOST:
                self._kept, self._every = self._kept[::2], 2 * self._every
        self._count += 1

    def finish(self) -> None:
        """Write the file.

        Raises:
            OSError: The file cannot be written.
        """
        self._reduce()
        first, *rest = self._kept
        first.save(self._file, "GIF", save_all=True, append_images=rest, duration=list(self._durations()), loop=0)

    def abort(self) -> None:
        """Forget the pictures."""
        self._early.clear()
        self._kept.clear()

    def _reduce(self) -> None:
        """Reduce the colours of pictures to those of the palette."""
        if self._early and self._palette is None:
            self._palette = _palette(self._early)
        self._kept += [small.quantize(palette=self._palette, dither=Pillow.Dither.NONE) for small in self._early]
        self._early.clear()

    def _durations(self) -> Iterator[int]:
        """Yield how long each picture is shown, in milliseconds, so that rounding errors do not add up."""
        period, shown = 100 * self._every / self._fps, 0
        for i in range(len(self._kept)):
            until = max(round((i + 1) * period), shown + 1)
            yield 10 * (until - shown)
            shown = until


def _palette(pictures: Sequence[Pillow.Image]) -> Pillow.Image:
    """Return a palette for pictures and those like them."""
    strip = np.concatenate([np.asarray(picture)[::2, ::2] for picture in pictures])
    chosen = Pillow.fromarray(strip).quantize(_CHOSEN, method=Pillow.Quantize.MEDIANCUT).getpalette() or []
    chosen = (chosen + _CHOSEN * 3 * [0])[: _CHOSEN * 3]
    cube = [value for r in _CUBE for g in _CUBE for b in _CUBE for value in (r, g, b)]
    palette = Pillow.new("P", (1, 1))
    palette.putpalette(chosen + cube)
    return palette
