"""The numbers that describe a D455, and what follows from them in closed form."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

from shape_obs.spec import Spec, SpecError

_UNBOUNDED: Final = math.inf
#: field -> (least, most, what it is); None passes where a field may be None
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
    """How far a D455's images are from clean ones.

    Geometry and depth noise are Intel's figures (data sheet of the D400 series; white paper "Tuning depth cameras for
    best performance"): the depth stream at 640 x 480, subpixel error 0.08 px on a well-textured plane, 1/32 px
    disparity steps. Shares of holes, and colour, differ from unit to unit and room to room: the defaults are moderate
    and say below what they rest on. *Native* pixels are those of that 640 x 480 stream; an image of another size is
    taken as that stream's, cropped to the aspect ratio about its centre and subsampled (not averaged) to its rows.

    Args:
        focal: Focal length f of the depth stream [native px].
        width: Width of the depth stream [px].
        height: Height of the depth stream [px].
        baseline: Distance B between the two imagers [m].
        subpixel: Standard deviation s of the disparity f B / z [native px]; 0 for no noise.
        correlation: Standard deviation l of the window over which matching smooths [native px]: the noise of two
            pixels r apart correlates as exp(-r^2 / 4 l^2). 2 px makes patches of 5 to 7 px, the size of the matcher's
            window. 0 for independent pixels.
        disparity_step: What disparity is rounded to [native px]; 0 for not at all.
        left_band: Whether the columns at the left without partner in the right imager, f B / z native px, are lost.
        edge_share: Share of the pixels beside a depth jump that are lost; 0 for none. The matching window there sees
            two surfaces, and one imager sees a strip that the other does not.
        edge_jump: What counts as a jump: disparity that differs by this much from the mean slope [native px]. 1 px
            is 9 mm at 0.56 m.
        edge_width: How far a jump reaches to each side [native px].
        dark_share: Share of the pixels that are lost on black; 0 for none.
        dark_level: Brightness, 0 to 255, from which on none is lost; below it the share rises linearly. Brightness is
            the largest of R, G and B: the imagers work in the near infrared, where dyes of strong colour are bright
            and what is dark in every channel mostly is dark as well.
        hole_size: Like `correlation`, of the holes at jumps and on dark surfaces, which so come in patches [native px].
        speckle_share: Share of all pixels lost in small blobs; 0 for none. The data sheet promises 99 % of pixels on a
            plain wall; half of what is missing there is given to speckle.
        speckle_size: Like `correlation`, of the blobs [native px].
        min_z: Depths under this are lost [m]; the data sheet's for 640 x 480. 0 for no limit.
        max_z: Depths above this are lost [m], the end of the camera's working range; None for no limit.
        exposure: Relative standard deviation, from episode to episode, of all code values.
        white_balance: The same of red and of blue against green.
        drift: How far exposure and white balance wander within an episode, as a multiple of the two above.
        drift_frames: Time constant of the drift [frames].
        read: Standard deviation of the colour noise in black [code values of 255].
        shot: Its growth with brightness: variance = read^2 + shot * value [code values].

    Example:
        >>> model = D455Model(speckle_share=0.01)
        >>> round(model.sigma(1.0) * 1000, 2)  # millimetres at one metre
        2.18

    Raises:
        SpecError: A value out of its range, which is told.
    """

    focal: float = 386.0
    width: int = 640
    height: int = 480
    baseline: float = 0.095
    subpixel: float = 0.08
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
        """The product f B [native px * m]: disparity is this over z."""
        return self.focal * self.baseline

    def scale(self, rows: int) -> float:
        """Pixels of an image of so many rows in one native pixel."""
        return rows / self.height

    def sigma(self, z: float) -> float:
        """Standard deviation of depth [m] at depth z [m], before any rounding: z^2 s / (f B)."""
        return z * z * self.subpixel / self.disparity_at_one_metre

    def depth_step(self, z: float) -> float:
        """Distance of neighbouring depths [m] at depth z [m]: z^2 / (32 f B) with the default step."""
        return z * z * self.disparity_step / self.disparity_at_one_metre

    def band_width(self, z: float) -> float:
        """Width of the left band [native px] before a wall at depth z [m]: f B / z; 0 where it is switched off."""
        return self.disparity_at_one_metre / z if self.left_band else 0.0

    def dark_probability(self, value: float) -> float:
        """Probability that a pixel is lost whose largest channel has this value, 0 to 255."""
        return self.dark_share * max(0.0, 1.0 - value / self.dark_level)

    def edge_reach(self, rows: int) -> tuple[int, float]:
        """Of an image of so many rows: how many pixels beside a jump may be lost, and with what probability.

        Where the native width is less than a pixel, so much less of the pixels are lost.
        """
        wide = self.edge_width * self.scale(rows)
        reach = max(1, round(wide))
        return reach, self.edge_share * min(1.0, wide / reach)
