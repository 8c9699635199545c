"""The arguments of a detector, as one spec."""

from __future__ import annotations

import math
import warnings
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

from shape_obs.clustering.base import Clusterer, Clustering, SelfOrganisingMap
from shape_obs.configurations.base import Anchor, Configuration, Ends, Order
from shape_obs.image.roi import ROI, Whole
from shape_obs.image.segmentation import Segmentation
from shape_obs.spec import Spec, SpecError
from shape_obs.tracking.missing import OnInvalid, OnMissing

if TYPE_CHECKING:
    from typing_extensions import Self

#: The version of the algorithm: equal images and arguments give equal points where it is equal. It grows with each
#: release that changes points, and is recorded with policies and tables, since the schema's hash does not show it.
#: 1: the first; lengths known in pixels, no time where stamps stand still. 2: lengths known in metres, evidence for
#: hidden ends, tips that do not turn round, a clock that always goes on. 3: ropes with depth are followed in space. 4:
#: points of ropes lie at the depth of their curve; sheets and outlines are laid in space, their hidden parts put back.
ALGORITHM: Final = 4
NO_BACKEND: Final = "backend={!r} is ignored: the inner loops are always compiled with Numba. Remove it."
#: The largest plausible values, in seconds and metres a second, and what larger ones are likely to be.
_MOST: Final = (
    ("dt", 2.0, "s between frames", "Is it milliseconds or frames a second? Give {0:.4g} / 1000 or 1 / {0:.4g}"),
    ("max_age", 60.0, "s", "Is it milliseconds? Give {0:.4g} / 1000"),
    ("max_speed", 100.0, "m/s", "Is it millimetres a second? Give {0:.4g} / 1000, or None for no limit"),
)


@dataclass(frozen=True)
class DetectorConfig(Spec):
    """The arguments of a ``ShapeDetector``.

    Args:
        shapes: The configurations to find, all in one pass.
        segmentation: The pixel rule, or a function ``(rgb, depth) -> mask``, see ``MaskFunction``; None when masks are
            given, or every shape has its own.
        roi: Where to look.
        order: ``"tracked"`` keeps point 0 on its material point; ``"image"`` numbers each frame again.
        ends: Default for shapes with ends or a border: ``"centers"`` or ``"tips"``.
        anchor: Default for shapes without one: where point 0 belongs.
        clustering: Where the points come from: ``"som"`` spreads them evenly over the form that the map is fitted with;
            ``"kmeans"``, ``"gmm"``, ``"fcm"`` and ``"kohonen"`` take a clusterer's centres, sorted along that form.
        on_missing: What a lost shape becomes: ``"hold"``, ``"truncate"``, ``"raise"`` or ``"nan"``.
        on_invalid: What a point without depth becomes: ``"nan"``, ``"interpolate"`` or ``"hold"``.
        max_age: Seconds for which a held shape counts as ok.
        max_speed: The fastest motion that is one object's: metres a second with depth and a camera, image widths a
            second without. If half of what is found lies farther from where the shape was, and from where its motion
            takes it, it is refused for five frames of continuous motion; then it is the same track if its path could
            have joined that one, else a new one. Cables that are swung through the air at 33 frames a second move by
            9 cm and 70 px a frame at most, which is 3 m and 3.6 widths a second. None sets no limit.
        dt: Seconds between frames without stamps, or whose stamps stand still, run back or jump by more than a day.

    Warns:
        UserWarning: ``dt``, ``max_age`` or ``max_speed`` is so large that it is likely in another unit.
    """

    shapes: tuple[Configuration, ...] = field(default_factory=lambda: (Configuration.from_dict("centerline"),))
    segmentation: Segmentation | None = None
    roi: ROI = field(default_factory=Whole)
    order: Order = "tracked"
    ends: Ends = "centers"
    anchor: Anchor = None
    clustering: Clustering = field(default_factory=SelfOrganisingMap)
    on_missing: OnMissing = "hold"
    on_invalid: OnInvalid = "nan"
    max_age: float = 0.5
    max_speed: float | None = 5.0
    dt: float = 1 / 30

    @classmethod
    def from_dict(cls, value: Any) -> Self:
        """Build the configuration as ``Spec.from_dict`` does; a ``backend`` of an older version is ignored.

        Warns:
            UserWarning: There is a ``backend``: the inner loops are always compiled now.
        """
        if isinstance(value, Mapping) and "backend" in value:
            warnings.warn(NO_BACKEND.format(value["backend"]), stacklevel=2)
            value = {name: field for name, field in value.items() if name != "backend"}
        return super().from_dict(value)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.shapes:
            raise SpecError("shapes: expected at least one configuration, got none.")
        names = [slot.name for shape in self.shapes for slot in shape.slots()]
        twice = [name for name, count in Counter(names).items() if count > 1]
        if twice:
            raise SpecError(f"shapes: two are named {twice[0]!r}; give each its own name=.")
        if not (0 <= self.max_age < math.inf and 0 < self.dt < math.inf):
            raise SpecError(f"expected finite max_age >= 0 and dt > 0 seconds, got {self.max_age} and {self.dt}.")
        if self.max_speed is not None and not 0 < self.max_speed < math.inf:
            raise SpecError(
                "max_speed: expected more than 0 metres a second (with depth) or image widths a second (without), or "
                f"None for no limit, got {self.max_speed}."
            )
        for name, most, unit, hint in _MOST:
            value = getattr(self, name)
            if value is not None and most < value < float("inf"):
                text = f"{name}: {value:.4g} {unit} is more than expected. {hint.format(value)}"
                warnings.warn(f"{text}; if it is meant, leave it.", stacklevel=7)
        if isinstance(self.clustering, Clusterer):
            for shape in self.resolved():
                for name, wanted in (("ends", "centers"), ("spacing", "px")):
                    if getattr(shape, name, wanted) != wanted:
                        raise SpecError(
                            f"shape {shape.name!r}: {name}={getattr(shape, name)!r} needs clustering='som': "
                            f"{self.clustering.kind!r} has its own centres; give {name}={wanted!r}."
                        )

    def filled(self) -> tuple[Configuration, ...]:
        """Return the configurations with this detector's defaults filled in."""
        filled = []
        defaults = {"order": self.order, "segmentation": self.segmentation, "anchor": self.anchor, "ends": self.ends}
        for shape in self.shapes:
            open_ones = {name: value for name, value in defaults.items() if getattr(shape, name, value) is None}
            filled.append(replace(shape, **open_ones))
        return tuple(filled)

    @property
    def code_paths(self) -> tuple[str, ...]:
        """The import paths ``"module:function"`` of the user's code that the arguments name."""
        rules = [self.segmentation, *(shape.segmentation for shape in self.shapes)]
        return tuple(path for rule in rules if rule is not None and (path := rule.code_path))

    def resolved(self) -> tuple[Configuration, ...]:
        """Return a configuration for each shape to find, the detector's defaults filled in: one for each slot."""
        return tuple(slot for shape in self.filled() for slot in shape.slots())
