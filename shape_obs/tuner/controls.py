"""Which values of a spec a page can change, and within which range: derived from the fields of the spec."""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, Literal, Union

from shape_obs.image.segmentation import HUES, Segmentation
from shape_obs.spec import Spec
from shape_obs.tuner.history import Path

#: Label, least, greatest and step of the values of a spec, by the spec's kind or, for all kinds, by the field.
_KNOWN: Final[dict[tuple[str, str], tuple[str, float, float, float]]] = {
    ("", "open"): ("Remove specks (px)", 0, 31, 1),
    ("", "close"): ("Close gaps (px)", 0, 31, 1),
    ("", "min_area"): ("Smallest piece (px)", 1, 5000, 1),
    ("", "min_share"): ("Smallest share", 0, 1, 0.01),
    ("click", "strictness"): ("Strictness", -8, 12, 0.1),
    ("gray", "low"): ("Brightness from", 0, 255, 1),
    ("gray", "high"): ("Brightness to", 0, 255, 1),
    ("depth", "near"): ("Depth from (m)", 0.05, 5, 0.005),
    ("depth", "far"): ("Depth to (m)", 0.05, 5, 0.005),
    ("centerline", "n"): ("Points N", 2, 100, 1),
    ("contour", "n"): ("Points N", 3, 200, 1),
    ("surface", "rows"): ("Rows", 2, 30, 1),
    ("surface", "cols"): ("Columns", 2, 30, 1),
    ("surface", "epochs"): ("Epochs of the map", 0, 20, 1),
    ("surface", "freedom"): ("Freedom of a corner", 0.01, 1, 0.01),
    ("", "radius"): ("Radius of the object (m)", 0, 0.05, 0.0005),
}
_HSV: Final = (("Hue", HUES - 1), ("Saturation", 255), ("Brightness", 255))
#: Fields that are not numbers or choices of the object itself, or that have a control of their own on the page.
_ELSEWHERE: Final = frozenset({"name", "count", "anchor", "segmentation", "order", "length", "ring", "hole"})
_NAMES: Final = {"ends": "Ends", "lift": "Fit", "spacing": "Equal gaps in"}


@dataclass(frozen=True)
class Control:
    """A value that a page can change.

    Args:
        path: Where the value is in the spec as plain values.
        label: What the page calls it.
        type: ``"number"`` for a slider, ``"choice"`` or ``"switch"``.
        least: Smallest value of a slider.
        most: Greatest value of a slider.
        step: From one value of a slider to the next.
        choices: Values to choose from.
    """

    path: Path
    label: str
    type: Literal["number", "choice", "switch"]
    least: float = 0.0
    most: float = 1.0
    step: float = 1.0
    choices: tuple[Any, ...] = ()

    @property
    def whole(self) -> bool:
        """Whether values are integers."""
        return float(self.step).is_integer()


def controls_of(spec: Spec) -> list[Control]:
    """Return a control for each number, choice and switch among the fields of a spec, thresholds first.

    Args:
        spec: A segmentation or a configuration. Kinds of other packages are handled too: a number whose range is
            unknown gets a slider from 0 to four times its value.
    """
    hints = typing.get_type_hints(type(spec))
    found = [
        control
        for field in dataclasses.fields(spec)  # type: ignore[arg-type]
        if field.name not in _ELSEWHERE
        for control in _controls(spec, field.name, hints[field.name])
    ]
    common = {field.name for field in dataclasses.fields(Segmentation)}
    return sorted(found, key=lambda control: control.path[0] in common)


def _controls(spec: Spec, name: str, hint: Any) -> Iterator[Control]:
    value = getattr(spec, name)
    if spec.kind == "hsv" and name in ("low", "high"):
        for i, (channel, top) in enumerate(_HSV if name == "low" else ()):  # both bounds of a channel together
            yield Control(("low", i), f"{channel} from", "number", 0, top, 1)
            yield Control(("high", i), f"{channel} to", "number", 0, top, 1)
        return
    options = _options(hint)
    if options:
        yield Control((name,), _NAMES.get(name, _spelt(name)), "choice", choices=options)
    elif isinstance(value, bool):
        yield Control((name,), _spelt(name), "switch")
    elif isinstance(value, (int, float)):
        yield _number(spec.kind, (name,), name, value)
    elif isinstance(value, tuple) and 1 <= len(value) <= 4 and all(_is_number(each) for each in value):
        for i, each in enumerate(value):
            yield _number(spec.kind, (name, i), f"{name} {i}", each)


def _number(kind: str, path: Path, name: str, value: float) -> Control:
    known = _KNOWN.get((kind, name)) or _KNOWN.get(("", name))
    if known is None:
        most = max(4 * abs(value), 1.0)
        whole = isinstance(value, int)
        known = (_spelt(name), min(4 * value, 0.0), round(most) if whole else most, 1 if whole else most / 400)
    label, least, most, step = known
    return Control(path, label, "number", min(least, value), max(most, value), step)


def _options(hint: Any) -> tuple[Any, ...]:
    """Return the values of a ``Literal``, also of one that may be None."""
    parts = typing.get_args(hint) if typing.get_origin(hint) in (Union, types.UnionType) else (hint,)
    return tuple(value for part in parts if typing.get_origin(part) is Literal for value in typing.get_args(part))


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _spelt(name: str) -> str:
    return name.replace("_", " ").capitalize()
