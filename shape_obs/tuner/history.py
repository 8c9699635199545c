"""The settings that a page changes, with undo and redo."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from shape_obs.frame import Frame

Pixel = tuple[float, float]
Path = tuple[str | int, ...]

_SAME_DRAG: Final = 1.5  # seconds, within which changes of one value are undone together
_MOST: Final = 200  # steps


@dataclass(frozen=True)
class Settings:
    """Everything that undo brings back.

    Args:
        arguments: Of ``ShapeDetector`` or ``ShapeObservation``, as plain values.
        picks: Pixels (u, v) that were clicked on the object.
        nots: Pixels (u, v) that are not on it.
        text: What was found at the clicks, in words.
        frame: The frame that was clicked last.
    """

    arguments: Mapping[str, Any] = field(default_factory=dict)
    picks: tuple[Pixel, ...] = ()
    nots: tuple[Pixel, ...] = ()
    text: str = ""
    frame: Frame | None = field(default=None, repr=False, compare=False)


class History:
    """Settings, and those before and after them.

    Args:
        first: The settings to start with.
    """

    def __init__(self, first: Settings) -> None:
        self.now = first
        self._before: list[Settings] = []
        self._after: list[Settings] = []
        self._last: tuple[Path, float] = ((), 0.0)

    @property
    def can_undo(self) -> bool:
        """Whether there is an earlier state."""
        return bool(self._before)

    @property
    def can_redo(self) -> bool:
        """Whether there is a later state."""
        return bool(self._after)

    def add(self, settings: Settings, path: Path = ()) -> None:
        """Make other settings the present ones.

        Args:
            settings: The new settings.
            path: The value that was changed. Changes of one value that follow each other quickly, as those of a slider
                do, are undone together. Empty for a change that is undone by itself.
        """
        now = time.monotonic()
        same = bool(path) and self._last[0] == path and now - self._last[1] < _SAME_DRAG
        if not (same and self._before):
            self._before = [*self._before, self.now][-_MOST:]
        self._after, self._last, self.now = [], (path, now), settings

    def undo(self) -> bool:
        """Go one step back; return whether there was one."""
        return self._move(self._before, self._after)

    def redo(self) -> bool:
        """Go one step forward again; return whether there was one."""
        return self._move(self._after, self._before)

    def _move(self, here: list[Settings], there: list[Settings]) -> bool:
        if not here:
            return False
        there.append(self.now)
        self.now, self._last = here.pop(), ((), 0.0)
        return True


def value_at(values: Any, path: Path) -> Any:
    """Return the value at a path of keys and indices in nested plain values."""
    for key in path:
        values = values[key]
    return values


def replace_at(values: Any, path: Path, value: Any) -> Any:
    """Return a copy of nested plain values with another value at a path; what is not on the path is shared."""
    if not path:
        return value
    key, rest = path[0], path[1:]
    if isinstance(values, Mapping):
        return {**values, key: replace_at(values.get(key) if rest else None, rest, value)}
    assert isinstance(values, Sequence)
    assert isinstance(key, int)
    return [replace_at(item, rest, value) if i == key else item for i, item in enumerate(values)]
