"""Controls are derived from the fields of specs, also of kinds that this package does not have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from shape_obs.image.segmentation import ColourRule, DepthRange, GrayRange, HSVRange
from shape_obs.tuner.controls import controls_of


@dataclass(frozen=True)
class Reddish(ColourRule, kind="tuner_reddish"):
    """A rule of another package."""

    lead: int = 40
    weight: float = 0.5
    strict: bool = False
    space: Literal["lab", "rgb"] = "lab"
    centre: tuple[float, float, float] = (50.0, 20.0, -3.0)
    note: str = ""

    def matches(self, rgb):
        return rgb[..., 0] > self.lead


def test_each_threshold_of_the_own_rules_has_a_slider():
    hsv = controls_of(HSVRange((170, 80, 60), (10, 255, 255)))
    assert [each.path for each in hsv[:6]] == [(bound, i) for i in range(3) for bound in ("low", "high")]
    assert [each.most for each in hsv[:6]] == [179, 179, 255, 255, 255, 255]
    common = ["open", "close", "min_area", "min_share"]
    for rule, names in ((GrayRange(10, 90), ["low", "high"]), (DepthRange(0.3, 0.9), ["near", "far"])):
        assert [each.path[0] for each in controls_of(rule)] == [*names, *common]
    assert [each.path[0] for each in hsv[6:]] == common


def test_a_value_beyond_the_range_of_a_slider_widens_it():
    (area,) = (each for each in controls_of(GrayRange(min_area=9000)) if each.path == ("min_area",))
    assert area.most == 9000


def test_a_rule_of_another_package():
    found = {each.path: each for each in controls_of(Reddish())}
    lead, weight = found["lead",], found["weight",]
    assert (lead.least, lead.most, lead.whole) == (0, 160, True)
    assert (weight.least, weight.most, weight.whole) == (0, 2.0, False)
    assert found["strict",].type == "switch"
    assert found["space",].choices == ("lab", "rgb")
    assert found["centre", 2].least == -12
    assert ("note",) not in found
