"""The option ``--rerun``, whose value may be left out: where a command logs to rerun."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from shape_obs.utils.errors import UsageError

if TYPE_CHECKING:
    from shape_obs.detector import ShapeDetector
    from shape_obs.drawing.rerun_stream import RerunStream
    from shape_obs.recording import Moment
    from shape_obs.shape import Detection

#: Stands for the value that the user left out.
AUTO: Final = "auto"
#: The metavar of the option.
TARGET: Final = "[FILE.rrd]"
_OPTION: Final = "--rerun"


def with_rerun_value(argv: Sequence[str]) -> list[str]:
    """Insert the value ``auto`` after each ``--rerun`` without one, since the parser needs a value.

    The value is recognised by its form, ``*.rrd`` or an address, so that what follows the bare option stays an argument
    of its own.
    """
    words = []
    for number, word in enumerate(argv, 1):
        following = argv[number] if number < len(argv) else ""
        words.append(word)
        if word == _OPTION and not (following.endswith(".rrd") or "://" in following):
            words.append(AUTO)
    return words


def check_target(value: str, name: str) -> None:
    """Check that a value is a file named ``*.rrd``, an address, or ``auto``.

    Raises:
        UsageError: It is none of these.
    """
    if value != AUTO and not value.endswith(".rrd") and "://" not in value:
        raise UsageError(f"{name}: expected FILE.rrd or rerun+http://HOST:9876/proxy, got {value!r}.")


def rerun_file(target: str | None, output: Path) -> Path | None:
    """Return the file that ``--rerun`` writes; None if it opens a viewer, or was not given. See ``open_rerun``."""
    if target == AUTO:
        return None if has_display() else output.with_name(output.name + ".rrd")
    return Path(target) if target is not None and target.endswith(".rrd") else None


def has_display() -> bool:
    """Return whether a window can be opened: on Linux, whether X11 or Wayland is there."""
    return sys.platform in ("win32", "darwin") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def open_rerun(target: str, output: Path, prog: str) -> RerunStream:
    """Open the stream that ``--rerun`` asks for, and print on stderr where it goes.

    Args:
        target: ``FILE.rrd``, the address of a viewer, or ``auto``: a viewer where there is a display, else a file.
        output: Where that file is written, with the suffix ``.rrd`` added.
        prog: The command, for the message.

    Raises:
        ImportError: rerun is not installed.
        ValueError: The target is neither a file named ``*.rrd`` nor an address.
        OSError: The file cannot be written, or there is no viewer.
    """
    from shape_obs.drawing.rerun_stream import VIEWER, RerunStream

    stream = RerunStream(rerun_file(target, output) or (VIEWER if target == AUTO else target))
    if stream.path is not None:
        print(f"{prog}: logs to {stream.path}; open it with: rerun {stream.path}", file=sys.stderr)
    return stream


def working_file(source: str) -> Path:
    """Return where a file about a source goes in the working folder, without suffix: ``rope`` for ``data/rope.db3``."""
    path = Path(source)
    return Path((path.stem if path.is_file() else path.name).replace(":", "-"))


class FrameLog:
    """Log the frames of a source to rerun, and with a detector the mask, the shapes and the features.

    Args:
        stream: The open stream.
        detector: What found the shapes; None for frames alone.
        arguments: Its configuration with the features, as ``load_config`` returns it.
    """

    def __init__(
        self, stream: RerunStream, detector: ShapeDetector | None = None, arguments: Mapping[str, Any] | None = None
    ) -> None:
        from shape_obs.drawing import RerunLog

        self._log, self._detector, self._features = RerunLog(stream.recording), detector, None
        if detector is not None and arguments is not None:
            from shape_obs.extraction.extraction import FeatureLog
            from shape_obs.features import read_features

            features = read_features(arguments.get("features") or ())
            age = detector.config.max_age
            self._features = FeatureLog(features, detector.shapes, arguments.get("workspace"), age)

    def add(self, moment: Moment, detection: Detection | None = None) -> None:
        """Log a frame, and what was found in it. Features that cannot be computed are left out with a warning."""
        from shape_obs.drawing.matching_pixels import matching_pixels

        frame, values = moment.frame, None
        if self._features is not None and detection is not None:
            try:
                values = self._features.add(moment, detection)
            except ValueError as error:  # it lacks depth, or the pose of the camera, which shapes do not need
                warnings.warn(f"no features are logged to rerun: {error}", UserWarning, stacklevel=2)
                self._features = None
        self._log.log(
            detection,
            frame.rgb,
            frame.depth,
            frame.camera,
            mask=None if self._detector is None else matching_pixels(frame, self._detector),
            features=values,
            number=frame.number,
            stamp=frame.stamp,
        )
