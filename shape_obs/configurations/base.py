"""What all configurations share: their fields, and what each one defines."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Final, Literal, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.curve import NO_VALUES
from shape_obs.geometry.observed import Observed, Samples
from shape_obs.geometry.topology import Topology
from shape_obs.image.region import Region
from shape_obs.image.segmentation import Segmentation
from shape_obs.initialization.objects import SceneObject, find_components
from shape_obs.spec import Spec, did_you_mean
from shape_obs.tracking.model import MotionModel
from shape_obs.tracking.predict import Fit, Prediction
from shape_obs.tracking.scene import Scene
from shape_obs.utils.lengths import warn_unless_metres

#: Take the order of the points from the previous frame, or from the image alone.
Order: TypeAlias = Literal["tracked", "image"]
#: Space points evenly in pixels, or in metres.
Spacing: TypeAlias = Literal["px", "m"]
#: Fit in the image and add depth, or fit in space.
Lift: TypeAlias = Literal["points", "cloud"]
#: Put the first and last point into the middle of their parts of the rope, or on its tips.
Ends: TypeAlias = Literal["centers", "tips"]
Place = str | tuple[float, float] | tuple[float, float, float]
#: Name the place of point 0, or give it as ``(u, v)`` in pixels or ``(x, y, z)`` in metres, also for each slot.
Anchor: TypeAlias = Place | Mapping[str, Place] | None
Count = int | Literal["all"] | None
Array = npt.NDArray[np.float64]

MOST_SLOTS: Final = 16  # objects: pairs of them are compared, and colours to draw them in run out


class Points(NamedTuple):
    """The N points of a shape on its form.

    Args:
        places: ``(N, D)`` pixels or metres.
        interpolated: ``(N,)`` bool: on an interpolated piece of the form.
        nearest: ``(N,)`` which of the form's own points is nearest along it, where it may cross itself; else None.
        log_depth: ``(N,)`` of the form there, see ``FittedCurve.log_depth``; ``(0,)`` if it is not known.
        steep: ``(N,)`` how much longer the form is there in space than in the image; ``(0,)`` without its log-depth.
        off: ``(N,)`` metres by which points of a sheet may be off their material; ``(0,)`` if that is not measured.
    """

    places: Array
    interpolated: npt.NDArray[np.bool_]
    nearest: npt.NDArray[np.intp] | None = None
    log_depth: Array = NO_VALUES
    steep: Array = NO_VALUES
    off: Array = NO_VALUES


_MODULES = {kind: f"shape_obs.configurations.{kind}" for kind in ("centerline", "contour", "surface")}


@dataclass(frozen=True, kw_only=True)
class Configuration(Spec, family="configuration", modules=_MODULES):
    """One shape to find.

    Args:
        name: What the shape is called; default its kind.
        count: How many such objects to find in one mask, each in a slot of its own: shapes ``name0``, ``name1``, ...
            None finds one, called ``name``; ``"all"`` opens a slot for each that is found (a detector alone does that:
            an observation has a fixed size).
        anchor: Where point 0 belongs: a pixel (u, v), a base-frame point (x, y, z) in metres, or a name that
            ``detect(anchors={...})`` resolves; None leaves it to the image's top-left. With a count, a mapping from the
            names of slots to anchors ties slots to what lies there.
        order: Overrides the detector's.
        segmentation: Overrides the detector's.
        lift: ``"points"`` fits in the image and puts depth under the points found; ``"cloud"`` fits in space, to the
            deprojected pixels, and gaps are equal in metres.
        spacing: Equal gaps in the image (``"px"``) or, with depth, in space (``"m"``); ignored for a cloud.
        radius: Metres from the visible surface to the axis; 0 reports the surface.
    """

    is_ribbon: ClassVar[bool] = False  # whether its nodes run along the middle of its mask
    resumes: ClassVar[bool] = False  # whether a fit can go on from a track after a loss longer than ``max_age``
    model: ClassVar[MotionModel] = MotionModel()  # the constants of its track

    name: str = ""
    count: Count = None
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
        if self.radius < 0 or not np.isfinite(self.radius):
            raise ValueError(f"{self.kind}: radius must be >= 0 metres, got {self.radius}.")
        warn_unless_metres(f"{self.kind}: radius", self.radius, most=0.5, stacklevel=5)
        if isinstance(self.count, int) and not 1 <= self.count <= MOST_SLOTS:
            raise ValueError(f"{self.kind}: count must lie in 1...{MOST_SLOTS}, be 'all' or None, got {self.count}.")
        anchors = self.anchor if isinstance(self.anchor, Mapping) else {self.name: self.anchor}
        for anchor in anchors.values():
            if isinstance(anchor, tuple) and not np.all(np.isfinite(anchor)):
                raise ValueError(f"{self.kind}: anchor must be finite, got {anchor}.")
        if isinstance(self.anchor, Mapping):
            self._check_anchored(self.anchor)

    def _check_anchored(self, anchor: Mapping[str, Place]) -> None:
        if self.count is None:
            raise ValueError(f"shape {self.name!r}: an anchor for each slot, {dict(anchor)}, needs count=.")
        known = [f"{self.name}{k}" for k in range(MOST_SLOTS if self.count == "all" else self.count)]
        for slot in anchor:
            if slot not in known:
                raise ValueError(f"shape {self.name!r}: anchor for unknown slot {slot!r}{did_you_mean(slot, known)}")

    def slots(self) -> tuple[Configuration, ...]:
        """Return a configuration for each object to find: itself without a count, else one for each slot."""
        return self._slots

    @cached_property
    def _slots(self) -> tuple[Configuration, ...]:
        if self.count is None:
            return (self,)
        named, slots = self.anchor, []
        for k in range(MOST_SLOTS if self.count == "all" else self.count):
            slot = f"{self.name}{k}"
            anchor = named.get(slot) if isinstance(named, Mapping) else named
            slots.append(replace(self, name=slot, count=None, anchor=anchor))
        return tuple(slots)

    @cached_property
    @abstractmethod
    def layout(self) -> Topology:
        """How the shape's points are connected."""

    def check_without_depth(self) -> None:
        """Raise an error if the shape needs what a frame without depth or camera does not have.

        Raises:
            ValueError: ``lift="cloud"`` or ``spacing="m"``.
        """
        if self.lift == "cloud":
            asked, instead = "lift='cloud'", "lift='points'"
        elif self.spacing == "m":
            asked, instead = "spacing='m'", "spacing='px'"
        else:
            return
        raise ValueError(f"shape {self.name!r}: {asked} needs depth and a camera; give both, or {instead}.")

    @property
    def compiled_functions(self) -> tuple[Any, ...]:
        """The compiled functions that a fit may call, so that they are ready before the first frame."""
        return ()

    def bare(self, region: Region) -> tuple[Region, bool]:
        """Return a mask without what is at the objects and is none of them, and whether there is such a thing."""
        return region, False

    def find_objects(
        self, region: Region, picture: npt.NDArray[np.uint8] | None = None
    ) -> tuple[list[SceneObject], str]:
        """Return the objects of a mask that holds several, largest first, and why there are none.

        Args:
            region: The mask.
            picture: ``(H, W, 3)`` RGB, if there is one.
        """
        return find_components(region)

    @abstractmethod
    def fit(self, observed: Observed, prediction: Prediction | None, target: Array | None, scene: Scene) -> Fit:
        """Fit the shape: from the prediction if there is one, else (or when that fails) from an initial form.

        Args:
            observed: What the object looks like in this frame.
            prediction: What is known of the shape before the frame; None at a cold start.
            target: Where point 0 belongs at a cold start, as ``observed.seen`` sees it; None for the top left.
            scene: Depth, camera and border: they show what lies over the object, and put it in space.
        """

    @abstractmethod
    def apply_index_order(self, form: Any, seen: Array, target: Array | None) -> Any:
        """Return the form numbered by the paper's rule.

        Args:
            form: In no particular direction.
            seen: ``(P, 2)`` its points in pixels; without an image, ``(P, D)`` its points.
            target: ``(2,)`` pixel where point 0 belongs (``(D,)`` point without an image); None for the top left.
        """

    @abstractmethod
    def resample(self, form: Any, metric: Any) -> Points:
        """Return the shape's points, evenly spread.

        Args:
            form: Where the points lie.
            metric: The same form in the space in which gaps are to be equal: pixels or metres.
        """

    def clusterer_samples(self, observed: Observed) -> Samples:
        """Return what a clusterer is given instead of the map's samples: every pixel or point, each counting once."""
        return observed.all_samples()
