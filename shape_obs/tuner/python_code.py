"""The settings of a page as a short Python program."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pprint import pformat
from typing import Any, Final

from shape_obs.config.config_file import detector_arguments
from shape_obs.config.detector_config import DetectorConfig
from shape_obs.spec import Spec, to_plain

_MOST_LINES: Final = 8
_FILE: Final = """from shape_obs import ShapeDetector, load_config
from shape_obs.config.config_file import detector_arguments

detector = ShapeDetector(**detector_arguments(load_config({file!r})))"""
_PHOTO: Final = """
rgb = cv2.cvtColor(cv2.imread({name!r}), cv2.COLOR_BGR2RGB)
shape = detector.detect(rgb).shapes[0]
print(shape.ok, shape.reason, shape.points2d)
"""
_SOURCE: Final = """
with open_source({name!r}) as source:
    frame = source.read()
    shape = detector.detect(frame.rgb, frame.depth, frame.camera, stamp=frame.stamp).shapes[0]
    print(shape.ok, shape.reason, shape.points2d)
"""


def python_code(arguments: Mapping[str, Any], source: str, kind: str, file: str) -> str:
    """Return a program that finds the shape in the first frame of a source.

    Args:
        arguments: Of the detector or the wrapper. Values that are the default are left out.
        source: The name of the source.
        kind: Its ``kind``; ``"photo"`` for a photo.
        file: The config file with the same settings. The program reads it if the settings do not fit into some lines,
            as the colours learnt from clicks do not.
    """
    end = (_PHOTO if kind == "photo" else _SOURCE).format(name=source)
    first = "import cv2\n\n" if kind == "photo" else "from shape_obs_envs.sources import open_source\n\n"
    config = DetectorConfig.from_dict(detector_arguments(arguments))
    given = _changed(config, skip={"shapes"})
    values = {"shapes": [_changed(shape) for shape in config.shapes], **given}
    lines = [f"    {name}={_indented(value, len(name) + 5)}," for name, value in values.items()]
    if sum(line.count("\n") + 1 for line in lines) > _MOST_LINES:
        return f"{first}{_FILE.format(file=file)}{end}"
    body = "\n".join(["detector = ShapeDetector(", *lines, ")"])
    return f"{first}from shape_obs import ShapeDetector\n\n{body}{end}"


def _changed(spec: Spec, skip: set[str] = frozenset()) -> dict[str, Any]:  # type: ignore[assignment]
    """Return the fields of a spec that differ from their defaults, as plain values."""
    values: dict[str, Any] = {"kind": spec.kind} if spec.kind else {}
    for field in dataclasses.fields(spec):  # type: ignore[arg-type]
        value = getattr(spec, field.name)
        default = field.default_factory() if callable(field.default_factory) else field.default
        named = field.name == "name" and value == spec.kind
        counts = field.name in ("n", "rows", "cols")  # how many points there are is worth a word
        if field.name not in skip and not named and (counts or value != default):
            values[field.name] = _changed(value) if isinstance(value, Spec) and value.kind else to_plain(value)
    return values


def _indented(value: Any, width: int) -> str:
    return pformat(value, width=110 - width, sort_dicts=False).replace("\n", "\n" + " " * width)
