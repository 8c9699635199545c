"""Parameters of the D455 model, and quantities that follow from them in closed form."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

from shape_obs.camera import DepthNoise
from shape_obs.spec import Spec, SpecError

_UNBOUNDED: Final = math.inf
#: field -> (least, most, description); None is accepted for fields that may be None
_RANGES: Final[dict[str, tuple[float, float, str]]] = {
    "focal": (1, 10_000, "a focal length in native pixels, 1 to 10000"),
    "width": (16, 4096, "a whole number of pixels from 16 to 4096"),
    "height": (16, 4096, "a whole number of pixels from 16 to 4096"),
    "baseline": (0.001, 10, "metres from 0.001 to 10"),
    "subpixel": (0, 10, "native pixels of disparity from 0 (no noise) to 10"),
    "correlation": (0, 50, "native pixels from 0 (independent pixels) to 50"),
    "disparity_step": (0, 10, "native pixels of disparity from 0 (not rounded) to 10"),
    "edge_share": (0, 1, "a share from 0 (none) to 1"),
    "edge_jump": (0.01, 1000, "native pixels of disparity from 0.01 to 1000"),
    "edge_width": (0.1, 50, "native pixels from 0.1 to 50"),
    "dark_share": (0, 1, "a share from 0 (none) to 1"),
    "dark_level": (1, 255, "a brightness from 1 to 255"),
    "hole_size": (0, 50, "native pixels from 0 (independent pixels) to 50"),
    "speckle_share": (0, 0.5, "a share from 0 (none) to 0.5"),
    "speckle_size": (0, 50, "native pixels from 0 (single pixels) to 50"),
    "min_z": (0, 100, "metres from 0 (no limit) to 100"),
    "max_z": (0, _UNBOUNDED, "metres above min_z, or None for no limit"),
    "exposure": (0, 1, "a relative standard deviation from 0 (none) to 1"),
    "white_balance": (0, 1, "a relative standard deviation from 0 (none) to 1"),
    "drift": (0, 10, "a multiple of exposure and white_balance from 0 (none) to 10"),
    "drift_frames": (1, 1e9, "frames, 1 or more"),
    "read": (0, 50, "code values from 0 (none) to 50"),
    "shot": (0, 10, "code values from 0 (none) to 10"),
}


@dataclass(frozen=True)
class D455Model(Spec):
    """Parameters of the errors in a D455's images.

    Geometry and depth noise are Intel's figures (data sheet of the D400 series; white paper "Tuning depth cameras for
    best performance"): the depth stream at 640 x 480, subpixel error 0.08 px on a well-textured plane, 1/32 px
    disparity steps. Fractions of holes and colour errors vary between units and rooms: the defaults are moderate, and
    their basis is stated below. *Native* pixels are those of the 640 x 480 stream; an image of another size is treated
    as that stream, cropped to the aspect ratio about its centre and subsampled (not averaged) to its rows.

    Args:
        focal: Focal length f of the depth stream in native pixels.
        width: Width of the depth stream in pixels.
        height: Height of the depth stream in pixels.
        baseline: Distance B between the two imagers in metres.
        subpixel: Standard deviation s of the disparity f B / z in native pixels; 0 for no noise.
        correlation: Standard deviation l of the matcher's smoothing window in native pixels: the noise of two pixels at
            distance r has the correlation exp(-r^2 / 4 l^2). 2 px results in patches of 5 to 7 px, the size of the
            matcher's window. 0 for independent pixels.
        disparity_step: Rounding step of the disparity in native pixels; 0 for no rounding.
        left_band: Whether the columns at the left that the right imager does not see, f B / z native px, are lost.
        edge_share: Fraction of lost pixels next to a depth jump; 0 for none. There the matching window covers two
            surfaces, and one imager sees a strip that the other does not.
        edge_jump: Smallest jump: difference of the disparity from the mean slope in native pixels. 1 px is 9 mm at
            0.56 m.
        edge_width: Reach of a jump to each side in native pixels.
        dark_share: Fraction of lost pixels on black; 0 for none.
        dark_level: Brightness, 0 to 255, above which no pixels are lost; below it the fraction rises linearly.
            Brightness is the largest of R, G and B: the imagers work in the near infrared, where strongly coloured dyes
            are bright, and surfaces that are dark in every channel are mostly dark as well.
        hole_size: Like ``correlation``, for the holes at jumps and on dark surfaces, in native pixels.
        speckle_share: Fraction of all pixels lost in small blobs; 0 for none. The data sheet promises 99 % of pixels on
            a plain wall; half of the missing ones are attributed to speckle.
        speckle_size: Like ``correlation``, for the blobs, in native pixels.
        min_z: Smallest measured depth in metres, from the data sheet for 640 x 480. 0 for no limit.
        max_z: Largest measured depth in metres, the end of the camera's working range; None for no limit.
        exposure: Relative standard deviation of all code values between episodes.
        white_balance: Relative standard deviation of red and of blue against green.
        drift: Drift of exposure and white balance within an episode, as a multiple of the two above.
        drift_frames: Time constant of the drift in frames.
        read: Standard deviation of the colour noise in black, in code values of 255.
        shot: Growth of the colour noise with brightness: variance = read^2 + shot * value, in code values.

    Example:
        >>> model = D455Model(speckle_share=0.01)
        >>> round(model.sigma(1.0) * 1000, 2)  # millimetres at one metre
        2.18

    Raises:
        SpecError: A value is out of its range; the message contains the range.
    """

    focal: float = 386.0
    width: int = 640
    height: int = 480
    baseline: float = DepthNoise.baseline
    subpixel: float = DepthNoise.disparity
    correlation: float = 2.0
    disparity_step: float = 1 / 32
    left_band: bool = True
    edge_share: float = 0.3
    edge_jump: float = 1.0
    edge_width: float = 2.0
    dark_share: float = 0.8
    dark_level: float = 80.0
    hole_size: float = 2.0
    speckle_share: float = 0.005
    speckle_size: float = 2.0
    min_z: float = 0.32
    max_z: float | None = 6.0
    exposure: float = 0.1
    white_balance: float = 0.04
    drift: float = 0.25
    drift_frames: float = 50.0
    read: float = 1.5
    shot: float = 0.03

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, (low, high, expected) in _RANGES.items():
            value: Any = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise SpecError(f"D455Model.{name}: expected {expected}, got {value!r}.")
        if self.max_z is not None and not self.min_z < self.max_z < _UNBOUNDED:
            raise SpecError(
                f"D455Model.max_z: expected {_RANGES['max_z'][2]}, got {self.max_z!r} with min_z {self.min_z!r}."
            )

    @property
    def disparity_at_one_metre(self) -> float:
        """The product f B in native pixels times metres; disparity is f B / z."""
        return self.focal * self.baseline

    def scale(self, rows: int) -> float:
        """Return how many pixels of an image with ``rows`` rows correspond to one native pixel."""
        return rows / self.height

    def sigma(self, z: float) -> float:
        """Return the standard deviation of depth in metres at depth z, before any rounding, see ``DepthNoise``."""
        return float(DepthNoise(self.subpixel, self.baseline).sigma(z, self.focal))

    def depth_step(self, z: float) -> float:
        """Return the distance in metres of neighbouring depths at depth z: z^2 / (32 f B) with the default step."""
        return z * z * self.disparity_step / self.disparity_at_one_metre

    def band_width(self, z: float) -> float:
        """Return the width of the left band in native pixels for a wall at depth z: f B / z; 0 if switched off."""
        return self.disparity_at_one_metre / z if self.left_band else 0.0

    def dark_probability(self, value: float) -> float:
        """Return the probability that a pixel is lost if its largest channel has this value, 0 to 255."""
        return self.dark_share * max(0.0, 1.0 - value / self.dark_level)

    def edge_reach(self, rows: int) -> tuple[int, float]:
        """Return how many pixels next to a jump may be lost in an image with ``rows`` rows, and their probability.

        If the native width is less than a pixel, the probability is reduced accordingly.
        """
        wide = self.edge_width * self.scale(rows)
        reach = max(1, round(wide))
        return reach, self.edge_share * min(1.0, wide / reach)
