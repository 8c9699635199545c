"""A detector's arguments as a YAML file of three sections.

``shape`` says what comes out (hashed: a policy is trained for it), ``scene`` where to look for it (differs from site
to site), ``runtime`` how to behave while running (free).
"""

from __future__ import annotations

import hashlib
import json
import os
import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from shape_obs.config.detector_config import NO_BACKEND, DetectorConfig
from shape_obs.spec import SpecError, did_you_mean, to_plain
from shape_obs.utils.documents import dump_yaml, is_of_script, read_yaml

if TYPE_CHECKING:
    from shape_obs.configurations.base import Configuration
    from shape_obs.features import Feature

VERSION: Final = 1
SECTIONS: Final = {
    "shape": ("shapes", "features", "order", "ends", "anchor", "clustering"),
    "scene": ("segmentation", "roi", "workspace"),
    "runtime": ("on_missing", "on_invalid", "max_age", "max_speed", "dt"),
}
#: Fields of a configuration that belong to the scene though they stand in the section ``shape``: they are not hashed.
SCENE_FIELDS: Final = ("segmentation", "length")
_WRAPPER_ONLY: Final = ("features", "workspace")


def load_config(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a YAML config file.

    Returns:
        The arguments of ``ShapeObservation`` in it; ``detector_arguments`` picks those of ``ShapeDetector``.

    Raises:
        FileNotFoundError: There is no such file.
        SpecError: The file is no YAML, of another version, or holds an unknown section or field.
    """
    data = read_yaml(path, "config")
    if not isinstance(data, Mapping):
        raise SpecError(f"{path}: expected 'version', 'shape', 'scene' and 'runtime', got {type(data).__name__}.")
    if data.get("version") != VERSION:
        raise SpecError(f"{path}: expected 'version: {VERSION}', got {data.get('version')!r}.")
    arguments: dict[str, Any] = {}
    for section, content in data.items():
        if section == "version":
            continue
        if section not in SECTIONS:
            raise SpecError(f"{path}: unknown section {section!r}{did_you_mean(section, SECTIONS)}")
        if not isinstance(content, Mapping):
            raise SpecError(f"{path}: section {section!r} must be a mapping, got {type(content).__name__}.")
        for name, value in content.items():
            if section == "runtime" and name == "backend":
                warnings.warn(f"{path}: {NO_BACKEND.format(value)}", stacklevel=2)
                continue
            if name not in SECTIONS[section]:
                raise SpecError(f"{path}: {section}: unknown field {name!r}{did_you_mean(name, SECTIONS[section])}")
            arguments[name] = value
    try:
        _filled(arguments)
    except ValueError as error:
        raise SpecError(f"{path}: {error}") from error
    return arguments


def save_config(path: str | os.PathLike[str], arguments: Mapping[str, Any]) -> None:
    """Write a YAML config file, whole or not at all, defaults filled in.

    Args:
        path: Where to.
        arguments: Arguments of ``ShapeDetector`` or ``ShapeObservation``, as specs or plain values.

    Raises:
        SpecError: A segmentation is a function that another program cannot import.
    """
    from shape_obs.utils.files import write_text

    write_text(Path(path), dump_config(arguments))


def dump_config(arguments: Mapping[str, Any]) -> str:
    """Return what ``save_config`` writes: YAML of three sections, defaults filled in."""
    for path in DetectorConfig.from_dict(detector_arguments(arguments)).code_paths:
        if is_of_script(path):
            raise SpecError(
                f"segmentation: {path} cannot be saved, since no other program can import it from the script or "
                "notebook in which it is defined. Move the function to a module, and give it, or its path "
                "'module:function'."
            )
    return dump_yaml(_sections(arguments))


def detector_arguments(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return those of a wrapper's arguments that a detector takes."""
    return {name: value for name, value in arguments.items() if name not in _WRAPPER_ONLY}


def schema_hash(arguments: Mapping[str, Any]) -> str:
    """Return the SHA-256 of the ``shape`` section: if it is equal, a policy reads the same numbers in the same places.

    Defaults are filled in, the detector's too, and ``SCENE_FIELDS`` left out: the colours of another site, or the
    length of another cable, do not change it.
    """
    return _sha256(hashed_values(arguments))


def hashed_values(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return the JSON values from which ``schema_hash`` is computed."""
    detector, features = DetectorConfig.from_dict(detector_arguments(arguments)), _features(arguments)
    return {
        "shapes": [_hashed_shape(shape) for shape in detector.filled()],
        "features": None if features is None else [feature.identity() for feature in features],
        "clustering": detector.clustering.to_dict(),
    }


def _hashed_shape(shape: Configuration) -> dict[str, Any]:
    """Return the values of a shape that are hashed; one without a count has the hash that it had before counts."""
    shape = replace(shape, segmentation=None)  # which may be a function that has no JSON values
    values = {name: value for name, value in shape.to_dict().items() if name not in SCENE_FIELDS}
    return values if shape.count is not None else {name: value for name, value in values.items() if name != "count"}


def config_hash(arguments: Mapping[str, Any]) -> str:
    """Return the SHA-256 of all three sections with defaults: if it is equal, detectors have equal arguments."""
    return _sha256(_sections(arguments))


def _sections(arguments: Mapping[str, Any]) -> dict[str, Any]:
    filled = _filled(arguments)
    return {"version": VERSION} | {
        section: {name: filled[name] for name in names if name in filled} for section, names in SECTIONS.items()
    }


def _sha256(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def _filled(arguments: Mapping[str, Any]) -> dict[str, Any]:
    extra = {"features": to_plain(_features(arguments)), "workspace": to_plain(arguments.get("workspace"))}
    given = {name: value for name, value in extra.items() if value is not None}
    return DetectorConfig.from_dict(detector_arguments(arguments)).to_dict() | given


def _features(arguments: Mapping[str, Any]) -> list[Feature] | None:
    if arguments.get("features") is None:
        return None
    from shape_obs.features import read_features  # a detector needs none

    return read_features(arguments["features"])
