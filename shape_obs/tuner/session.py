"""The settings that pages share, the detector made of them, and what it finds: all of a page but the page."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.clicks import propose_segmentation
from shape_obs.config.config_file import detector_arguments, dump_config, save_config
from shape_obs.config.detector_config import DetectorConfig
from shape_obs.configurations.base import Configuration
from shape_obs.detector import ShapeDetector
from shape_obs.frame import Frame
from shape_obs.image.segmentation import Segmentation
from shape_obs.spec import to_plain
from shape_obs.tuner.controls import Control, controls_of
from shape_obs.tuner.history import History, Path, Pixel, Settings, replace_at, value_at
from shape_obs.tuner.python_code import python_code

Image = npt.NDArray[np.uint8]

_AROUND: Final = 2  # pixels
_ALIKE: Final = 20  # levels by which the mean colour around a click may change, as by a camera's noise
READ_ONLY: Final = "This page is read-only: it was started with --read-only."
_WORDS: Final = {
    "pick: ": "",
    "give the colours with --hsv": "choose a colour range",
    "give pixels of the background with --not": "shift-click on the background",
}
_RULES: Final[dict[str, dict[str, Any]]] = {
    "hsv": {"kind": "hsv", "low": [0, 80, 40], "high": [179, 255, 255]},
    "gray": {"kind": "gray", "low": 0, "high": 90},
    "depth": {"kind": "depth", "near": 0.2, "far": 1.0},
}


class Session:
    """Settings with undo, and the detector that they describe. Methods may be called from several threads.

    A change that the detector refuses changes nothing: ``error`` says why, and the detector stays.

    Args:
        arguments: Of ``ShapeDetector`` or ``ShapeObservation``, as ``load_config`` returns them; None to start with a
            centerline and without a segmentation.
        read_only: Refuse every change.

    Attributes:
        on_change: Called after each change, also after one that was refused.
        version: Grows with each change, also with one that was refused.
        error: Why the last change was refused; empty if it was not.

    Raises:
        SpecError: The arguments are not understood.
    """

    def __init__(
        self, arguments: Mapping[str, Any] | None = None, *, read_only: bool = False, saved: bytes = b""
    ) -> None:
        self.read_only, self.version, self.error = read_only, 0, ""
        self.on_change: Callable[[], None] = lambda: None
        given = dict(arguments or {})
        config = DetectorConfig.from_dict(detector_arguments(given))
        plain = {**given, "shapes": to_plain(config.shapes), "roi": to_plain(config.roi)}
        plain["segmentation"] = to_plain(config.segmentation)
        self._history = History(Settings(plain))
        self._lock, self._saved = threading.RLock(), saved
        self._detector, self._config = _detector_of(plain), config

    @property
    def settings(self) -> Settings:
        """The present settings."""
        return self._history.now

    @property
    def config(self) -> DetectorConfig:
        """The arguments of the detector, as one spec."""
        return self._config

    @property
    def detector(self) -> ShapeDetector:
        """The present detector; each change makes another one."""
        return self._detector

    @property
    def shape(self) -> Configuration:
        """The first configuration: the one that the page changes."""
        return self._config.shapes[0]

    @property
    def rule(self) -> Segmentation | None:
        """The pixel rule of the first configuration; None before anything was clicked."""
        return self._config.filled()[0].segmentation

    @property
    def rule_path(self) -> Path:
        """Where that rule is among the arguments: the configuration's own or the detector's."""
        return ("segmentation",) if self.shape.segmentation is None else ("shapes", 0, "segmentation")

    @property
    def can_undo(self) -> bool:
        """Whether there is a change to undo."""
        return self._history.can_undo and not self.read_only

    @property
    def can_redo(self) -> bool:
        """Whether there is a change to redo."""
        return self._history.can_redo and not self.read_only

    def rule_controls(self) -> list[Control]:
        """Return the controls of the pixel rule; their paths begin at the arguments."""
        rule, head = self.rule, self.rule_path
        return [] if rule is None else [replace(each, path=(*head, *each.path)) for each in controls_of(rule)]

    def shape_controls(self) -> list[Control]:
        """Return the controls of the first configuration; their paths begin at the arguments."""
        return [replace(each, path=("shapes", 0, *each.path)) for each in controls_of(self.shape)]

    def value(self, path: Path) -> Any:
        """Return the value at a path of the arguments."""
        return value_at(self.settings.arguments, path)

    def set(self, path: Path, value: Any) -> bool:
        """Set a value of the arguments; return whether it was accepted."""
        with self._lock:
            now = self.settings
            return self._change(replace(now, arguments=replace_at(now.arguments, path, value)), path)

    def choose_shape(self, kind: str) -> bool:
        """Make the first configuration one of another kind; its rule and its count are kept."""
        with self._lock:
            kept = {name: value for name, value in self.shape.to_dict().items() if name in ("segmentation", "count")}
            return self.set(("shapes", 0), {"kind": kind, **kept})

    def choose_rule(self, kind: str) -> bool:
        """Make the pixel rule one of another kind, with thresholds to start from; its clean-up is kept."""
        with self._lock:
            clean = {"open", "close", "min_area", "min_share"}
            before = {} if self.rule is None else self.rule.to_dict()
            return self.set(self.rule_path, {**_RULES[kind], **{name: before[name] for name in clean & before.keys()}})

    def click(self, frame: Frame, pixel: Pixel, *, on_object: bool = True) -> bool:
        """Propose the segmentation from one more click; return whether there is one.

        Earlier clicks count where the frame still looks as it did there; see ``clicks_in``.

        Args:
            frame: The frame that was clicked.
            pixel: (u, v).
            on_object: Whether the object is there, or something else.
        """
        with self._lock:
            now = self.settings
            picks, nots = self.clicks_in(frame)
            if not on_object and not picks:
                moved = "It has moved since you clicked on it. " if now.picks else ""
                return self._refuse(f"{moved}Click on the object first; then on what is not the object.")
            picks, nots = ((*picks, pixel), nots) if on_object else (picks, (*nots, pixel))
            if frame.rgb is None:
                return self._refuse("The source has no colour image to click on.")
            try:
                proposal = propose_segmentation(frame.rgb, picks, nots, frame.depth)
            except ValueError as error:
                return self._refuse(_for_the_page(str(error)))
            arguments = replace_at(now.arguments, self.rule_path, proposal.rule.to_dict())
            return self._change(Settings(arguments, _plain(picks), _plain(nots), proposal.text, frame))

    def clicks_in(self, frame: Frame) -> tuple[tuple[Pixel, ...], tuple[Pixel, ...]]:
        """Return the clicks on and off the object around which a frame looks as the one that was clicked.

        In a camera's picture of a still scene these are all; where something has moved, a click means nothing any more.
        """
        settings = self.settings
        if settings.frame is None or settings.frame.rgb is None or frame.rgb is None:
            return (), ()
        before, now = settings.frame.rgb, frame.rgb
        if before is now:
            return settings.picks, settings.nots
        return _unmoved(before, now, settings.picks), _unmoved(before, now, settings.nots)

    def clear_clicks(self) -> bool:
        """Forget the clicks; the segmentation stays."""
        with self._lock:
            return self._change(replace(self.settings, picks=(), nots=(), text=""))

    def set_roi(self, corners: tuple[Pixel, Pixel] | None) -> bool:
        """Look in a rectangle between two opposite corners (u, v) only; None looks everywhere."""
        if corners is None:
            return self.set(("roi",), {"kind": "whole"})
        (u, v), (other_u, other_v) = corners
        left, top = round(min(u, other_u)), round(min(v, other_v))
        width, height = round(abs(u - other_u)), round(abs(v - other_v))
        roi = {"kind": "rectangle", "left": left, "top": top, "width": width, "height": height}
        return self.set(("roi",), roi)

    def undo(self) -> bool:
        """Undo the last change; return whether there was one."""
        with self._lock:
            return self._refuse(READ_ONLY) if self.read_only else self._history.undo() and self._apply()

    def redo(self) -> bool:
        """Make the last undone change again; return whether there was one."""
        with self._lock:
            return self._refuse(READ_ONLY) if self.read_only else self._history.redo() and self._apply()

    def yaml(self) -> str:
        """Return the settings as a YAML config file."""
        return dump_config(self.settings.arguments)

    def python(self, source: str, kind: str, file: str) -> str:
        """Return the settings as a Python program; see ``python_code``."""
        return python_code(self.settings.arguments, source, kind, file)

    def save(self, path: FilePath) -> None:
        """Write the settings to a YAML config file.

        Raises:
            PermissionError: The session is read-only.
            ValueError: There is no segmentation yet.
            FileExistsError: Another program changed the file since it was opened or saved.
            OSError: The file cannot be written.
        """
        if self.read_only:
            raise PermissionError(READ_ONLY)
        if self.rule is None:
            raise ValueError("Nothing to save yet: click on the object first.")
        file = FilePath(path)
        if file.exists() and file.read_bytes() != self._saved:
            raise FileExistsError(f"{path} was changed by another program: move or rename it, then save again.")
        save_config(path, self.settings.arguments)
        self._saved = file.read_bytes()

    def _change(self, settings: Settings, path: Path = ()) -> bool:
        if self.read_only:
            return self._refuse(READ_ONLY)
        try:
            detector = _detector_of(settings.arguments)
        except (ValueError, TypeError) as error:
            return self._refuse(str(error))
        self._history.add(settings, path)
        return self._apply(detector)

    def _apply(self, detector: ShapeDetector | None = None) -> bool:
        self._detector = detector or _detector_of(self.settings.arguments)
        self._config = DetectorConfig.from_dict(detector_arguments(self.settings.arguments))
        self.error, self.version = "", self.version + 1
        self.on_change()
        return True

    def _refuse(self, error: str) -> bool:
        self.error, self.version = error, self.version + 1
        self.on_change()
        return False


def _unmoved(before: Image, now: Image, pixels: tuple[Pixel, ...]) -> tuple[Pixel, ...]:
    """Return the pixels around which two images look alike."""
    if before.shape != now.shape:
        return ()
    kept = []
    for u, v in pixels:
        rows, columns = (slice(max(round(at) - _AROUND, 0), round(at) + _AROUND + 1) for at in (v, u))
        colours = [image[rows, columns].reshape(-1, 3).mean(axis=0) for image in (before, now)]
        if np.abs(colours[0] - colours[1]).max() <= _ALIKE:
            kept.append((u, v))
    return tuple(kept)


def _for_the_page(error: str) -> str:
    """Return an error about clicks in the words of the page, without options of the command line."""
    for option, words in _WORDS.items():
        error = error.replace(option, words)
    return error


def _plain(pixels: tuple[Pixel, ...]) -> tuple[Pixel, ...]:
    return tuple((float(u), float(v)) for u, v in pixels)


def _detector_of(arguments: Mapping[str, Any]) -> ShapeDetector:
    """Make the detector; a shape that is lost raises no error here, whatever ``on_missing`` says."""
    given = detector_arguments(arguments)
    if given.get("on_missing") == "raise":
        given["on_missing"] = "nan"
    return ShapeDetector(**given)
