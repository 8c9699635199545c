"""What every configuration is told: its name, its anchor, and what it overrides of the detector's defaults."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from shape_obs.region import Region
from shape_obs.segmentation import Segmentation
from shape_obs.spec import Spec
from shape_obs.topology import Chain

Order = Literal["tracked", "image"]
Spacing = Literal["px", "m"]
Anchor = str | tuple[float, float] | tuple[float, float, float] | None
Array = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Configuration(Spec, family="configuration"):
    """One shape to find.

    Args:
        name: What the shape is called; default its kind.
        anchor: Where point 0 belongs: a pixel (u, v), a base-frame point (x, y, z) in metres, or a name that
            ``detect(anchors={...})`` resolves; None leaves it to the image's top-left.
        order: Overrides the detector's.
        segmentation: Overrides the detector's.
        spacing: Equal gaps in the image (``"px"``) or, with depth, in space (``"m"``).
        radius: Metres from the visible surface to the axis; 0 reports the surface.
    """

    name: str = ""
    anchor: Anchor = None
    order: Order | None = None
    segmentation: Segmentation | None = None
    spacing: Spacing = "px"
    radius: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.name:
            object.__setattr__(self, "name", self.kind)
        if isinstance(self.anchor, tuple) and not np.all(np.isfinite(self.anchor)):
            raise ValueError(f"{self.kind}: anchor must be finite, got {self.anchor}.")
        if self.radius < 0 or not np.isfinite(self.radius):
            raise ValueError(f"{self.kind}: radius must be >= 0 metres, got {self.radius}.")

    @property
    @abstractmethod
    def count(self) -> int:
        """N, how many points the shape has."""

    @abstractmethod
    def unfit(self, region: Region) -> str:
        """Why a region cannot hold this shape; empty if it can. Asked before any work is done."""

    @abstractmethod
    def topology(self, region: Region) -> Chain:
        """The map that suits the region: how many nodes, and how they hang together."""

    @abstractmethod
    def parameterise(self, region: Region) -> Array:
        """(P,2) pixels: the curve that a cold start lays over the mask, in no particular direction."""

    @abstractmethod
    def finish(self, nodes: Array, region: Region) -> Array:
        """(P,2) pixels: the fine curve through the fitted nodes, from end to end of the object."""

    @abstractmethod
    def symmetries(self, nodes: Array) -> tuple[Array, ...]:
        """The ways to number the same nodes, the given one first."""

    @abstractmethod
    def positions(self, curve: Array, arc: Array) -> Array:
        """(N,) arc positions of the points on the fine curve, which may be given in pixels or in metres."""
