"""Controls are derived from the fields of specs, also of kinds that this package does not have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from shape_obs.image.segmentation import ColourRule
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


def test_a_rule_of_another_package():
    found = {each.path: each for each in controls_of(Reddish())}
    lead, weight = found["lead",], found["weight",]
    assert (lead.least, lead.most, lead.whole) == (0, 160, True)
    assert (weight.least, weight.most, weight.whole) == (0, 2.0, False)
    assert found["strict",].type == "switch"
    assert found["space",].choices == ("lab", "rgb")
    assert found["centre", 2].least == -12
    assert ("note",) not in found
