"""A modelled D455 whose images have one size: clean images in, measured ones out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.d455.bank import BankFields
from shape_obs_envs.d455.colour import Colour, Light
from shape_obs_envs.d455.depth import Measurement, Stereo
from shape_obs_envs.d455.fields import DrawnFields
from shape_obs_envs.d455.model import D455Model


class D455Camera:
    """Measures clean images of one size as a D455 would. All that is random comes from the generator that is passed.

    It remembers nothing between calls, but works in buffers of its own: one for each thread.

    Args:
        model: What the camera is like.
        size: (H, W) of the images [px].
        fast: Cut random fields out of a bank instead of drawing every pixel. Same statistics, a fraction of the time;
            the bank takes 8 MB at 640 x 480 and is shared by all cameras of this model and size in a process.

    Raises:
        ValueError: `size` is no image size.

    Example:
        >>> import numpy as np
        >>> camera, rng = D455Camera(D455Model(), (480, 640)), np.random.default_rng(0)
        >>> wall, white = np.full((480, 640), 1.0), np.full((480, 640, 3), 255, np.uint8)
        >>> metres, causes = camera.measure(wall, white, rng)
        >>> round(float(metres[causes == 0].std()), 3)
        0.002
    """

    def __init__(self, model: D455Model, size: Sequence[int], fast: bool = False) -> None:
        sides = [side for side in size if isinstance(side, (int, np.integer)) and side > 0]
        if len(size) != 2 or len(sides) != 2:
            raise ValueError(f"size: expected (height, width) in pixels, two whole numbers above 0, got {size!r}")
        self.model, self.size, self.fast = model, (int(sides[0]), int(sides[1])), bool(fast)
        self._stereo, self._colour = Stereo(model, self.size), Colour(model, self.size)
        self._fields = (BankFields if fast else DrawnFields)(model, self.size)

    def __reduce__(self) -> tuple[Any, ...]:
        """Buffers and bank do not travel."""
        return type(self), (self.model, self.size, self.fast)

    def measure(self, metres: NDArray[Any], rgb: NDArray[np.uint8], rng: np.random.Generator) -> Measurement:
        """Measure depth.

        Args:
            metres: (H, W) clean depth along the optical axis [m], any float type; no depth is 0 or not finite.
            rgb: (H, W, 3) uint8, the clean colours there, which tell dark surfaces.
            rng: Where randomness comes from.

        Returns:
            Measured depth, not yet rounded to millimetres, and why which pixel has none.

        Raises:
            ValueError: An image has another shape or type.
        """
        metres = np.asarray(metres)
        if metres.shape != self.size or not np.issubdtype(metres.dtype, np.floating):
            raise ValueError(
                f"metres: expected {self.size} floats, got {metres.shape} {metres.dtype}. "
                "Divide millimetres by 1000.0; for another size make another D455Camera."
            )
        return self._stereo.measure(metres, self._checked(rgb), self._fields, rng)

    def colour(self, rgb: NDArray[np.uint8], light: Light, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Take a colour image.

        Args:
            rgb: (H, W, 3) uint8, the clean colours.
            light: Exposure and white balance, from `Light.draw` and `Light.later`.
            rng: Where randomness comes from.

        Returns:
            (H, W, 3) uint8, a new array.

        Raises:
            ValueError: The image has another shape or type.
        """
        return self._colour.take(self._checked(rgb), light, self._fields, rng)

    def _checked(self, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
        rgb = np.asarray(rgb)
        if rgb.shape != (*self.size, 3) or rgb.dtype != np.uint8:
            raise ValueError(
                f"rgb: expected {(*self.size, 3)} uint8, got {rgb.shape} {rgb.dtype}. "
                "For another size make another D455Camera."
            )
        return np.ascontiguousarray(rgb)
