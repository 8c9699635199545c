"""What every configuration is told, and the steps in which each one finds its shape."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Final, Generic, Literal, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from shape_obs.clustering import som
from shape_obs.geometry.form import Form
from shape_obs.geometry.samples import Samples, single
from shape_obs.geometry.topology import Topology
from shape_obs.image.region import Region
from shape_obs.image.segmentation import Segmentation
from shape_obs.point_cloud.body import Body
from shape_obs.point_cloud.cloud import Cloud
from shape_obs.spec import Spec
from shape_obs.tracking.prediction import Prediction
from shape_obs.tracking.validation import Verdict

Order = Literal["tracked", "image"]
Spacing = Literal["px", "m"]
Lift = Literal["points", "cloud"]
Ends = Literal["centers", "tips"]
Origin = Literal["cold", "tracked", "gap"]
Anchor = str | tuple[float, float] | tuple[float, float, float] | None
Array = npt.NDArray[np.float64]
F = TypeVar("F", bound=Form)

# Width of the map's neighbourhood in each epoch, node units. Where a part of the object was hidden in the last frame,
# what comes back has no node near it.
WIDTHS: Final = {"cold": (0.8, 0.4, 0.4), "tracked": (0.8, 0.4), "gap": (1.2, 0.6, 0.4, 0.4)}


class Points(NamedTuple):
    """The N points of a shape on its form.

    Args:
        places: (N,D) pixels or metres.
        bridged: (N,) bool: on a bridged piece of the form.
    """

    places: Array
    bridged: npt.NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class Configuration(Spec, Generic[F], family="configuration"):
    """One shape to find.

    Args:
        name: What the shape is called; default its kind.
        anchor: Where point 0 belongs: a pixel (u, v), a base-frame point (x, y, z) in metres, or a name that
            ``detect(anchors={...})`` resolves; None leaves it to the image's top-left.
        order: Overrides the detector's.
        segmentation: Overrides the detector's.
        lift: ``"points"`` fits in the image and puts depth under the points found; ``"cloud"`` fits in space, to the
            deprojected pixels, and gaps are equal in metres.
        spacing: Equal gaps in the image (``"px"``) or, with depth, in space (``"m"``); no say over a cloud.
        radius: Metres from the visible surface to the axis; 0 reports the surface.
    """

    name: str = ""
    anchor: Anchor = None
    order: Order | None = None
    segmentation: Segmentation | None = None
    lift: Lift = "points"
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
    def layout(self) -> Topology:
        """How the shape's points hang together."""

    @property
    def count(self) -> int:
        """N, how many points the shape has."""
        return self.layout.size

    @abstractmethod
    def unfit(self, body: Body) -> str:
        """Why a body cannot hold this shape; empty if it can. Asked before any work is done."""

    @abstractmethod
    def samples(self, body: Body) -> Samples:
        """What the map is fitted to: all of the body, or its outline."""

    def all_samples(self, body: Body) -> Samples:
        """What a clusterer is given instead: every pixel of the mask, every point of the cloud, each counting once."""
        if isinstance(body, Cloud):
            return Samples(body.kept, np.ones(len(body.kept)), body.grain)
        return single(body.pixels, body.window)

    @abstractmethod
    def topology(self, body: Body) -> Topology:
        """The map that suits the body: how many nodes, and how they hang together."""

    @abstractmethod
    def parameterise(self, body: Body) -> F:
        """The form that a cold start lays over the body, in no particular direction."""

    @abstractmethod
    def nodes(self, form: F, topology: Topology) -> Array:
        """(K,D) where the map's nodes sit on a form."""

    def widths(self, origin: Origin) -> tuple[float, ...]:
        """Width of the map's neighbourhood in each epoch, node units; none where the start is not to be moved.

        Args:
            origin: Where the start comes from: a cold one, a track, or a track of which a part was hidden.
        """
        return WIDTHS[origin]

    def settled(self, start: Array, body: Body, topology: Topology, origin: Origin) -> F:
        """The form that the map takes from a start, finished."""
        widths = self.widths(origin)
        nodes = som.fit(self.samples(body), start, topology, widths, body.kernels) if widths else start
        return self.finish(nodes, body)

    @abstractmethod
    def finish(self, nodes: Array, body: Body) -> F:
        """The fine form through the fitted nodes, over the whole of the body."""

    @abstractmethod
    def judge(self, form: F, body: Body, bridged: float) -> Verdict:
        """How well a form explains the body, and why it cannot be believed.

        Args:
            form: The finished form.
            body: What it was fitted to.
            bridged: The share of the form that may lie off the body: gaps that a cold start has bridged, or what a
                known size says is hidden.
        """

    @abstractmethod
    def numbered(self, form: F, seen: Array, target: Array | None) -> F:
        """The form numbered by the paper's rule, as a cold start numbers it.

        Args:
            form: In no particular direction.
            seen: (P,2) its points in pixels; without an image, (P,D) its points.
            target: (2,) pixel where point 0 belongs ((D,) point without an image); None for the top left.
        """

    @abstractmethod
    def follow(self, form: F, prediction: Prediction) -> F:
        """The form numbered as the prediction is, so that points stay on their material."""

    def warm(self, body: Body, prediction: Prediction) -> Array:
        """(K,D) where the nodes start on a frame that has a past."""
        return self.nodes(self.follow(self.parameterise(body), prediction), prediction.topology)

    def known(self, body: Body, prediction: Prediction) -> Body:
        """The body with what the past knows about it, for a warm frame."""
        return body

    def girth(self, form: F, body: Body) -> float:
        """How wide the body is, for the next frame; 0 where that is not known beforehand."""
        return body.width if isinstance(body, Region) else 0.0

    @abstractmethod
    def place(self, form: F, metric: F) -> Points:
        """The shape's points, evenly spread.

        Args:
            form: Where the points lie.
            metric: The same form in the space in which gaps are to be equal: pixels or metres.
        """
