"""What commands with ``--source`` share."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import cv2

from shape_obs.source import RGBDSource
from shape_obs.utils.documents import parse_yaml

_ERRORS_ALONE: Final = 2  # OpenCV's LOG_LEVEL_ERROR


def open_named(text: str, extrinsics: Path | None = None, settings: Sequence[str] = (), **options: Any) -> RGBDSource:
    """The source that ``--source``, ``--extrinsics`` and ``--set`` name; not connected yet.

    Args:
        text: ``d455[:serial]``, a file, a folder or an environment's id.
        extrinsics: A file that says where the camera stands.
        settings: ``KEY=VALUE``, for arguments of the source's class; values are read as YAML.
        options: Further arguments.

    Raises:
        ValueError: Settings that are none, or that the source does not have.
        SourceError: No such source.
    """
    from shape_obs_envs.sources import open_source

    return open_source(text, extrinsics=extrinsics, **options, **read_settings(settings))


def read_settings(settings: Sequence[str], option: str = "--set") -> dict[str, Any]:
    """``["exposure=0.01", "camera=d455"]`` -> a mapping, values read as YAML.

    Args:
        settings: What was given.
        option: Its name, for messages.

    Raises:
        ValueError: Not ``KEY=VALUE``, or a value that is no YAML.
    """
    values: dict[str, Any] = {}
    for setting in settings:
        name, equals, value = setting.partition("=")
        if not name.isidentifier() or not equals:
            raise ValueError(f"{option}: expected KEY=VALUE, such as exposure=0.01, got {setting!r}.")
        values[name] = parse_yaml(value, f"{option} {setting[:60]}")
    return values


@contextmanager
def warnings_as_lines(prog: str) -> Iterator[None]:
    """Warnings of the library become one line each on stderr; decoders say nothing, since errors say it better."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    opencv: Any = cv2 if hasattr(cv2, "setLogLevel") else cv2.utils.logging  # of OpenCV 4 and 5
    opencv.setLogLevel(_ERRORS_ALONE)

    def show(message: Warning | str, *_: Any) -> None:
        print(f"{prog}: {' '.join(str(message).split())}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = show
        yield
