"""Methods in turn on the same work: what each takes, and how good its points are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import cv2
import numpy as np

from shape_obs.bench.point_quality import Quality, point_quality
from shape_obs.bench.turns import Clock, Entrant, turns
from shape_obs.bench.workloads import Scene, Work

WARM_UP: Final = 5  # frames that are not counted: imports, compilation, the first cold start


@dataclass
class Score:
    """What one method did.

    Args:
        milliseconds: Frame -> time.
        quality: Of its points, on the frames on which every method ran.
    """

    milliseconds: dict[int, float] = field(default_factory=dict)
    quality: list[Quality] = field(default_factory=list)

    @property
    def median(self) -> float:
        """Milliseconds."""
        return float(np.median([*self.milliseconds.values()]))

    def mean(self, measure: str) -> float:
        """Of a measure over the frames on which quality was looked at."""
        return float(np.mean([getattr(quality, measure) for quality in self.quality]))

    def times(self, other: Score) -> float:
        """How many times slower than another method: the ratio of the medians over the frames of both."""
        both = self.milliseconds.keys() & other.milliseconds.keys()
        mine, theirs = (np.median([score.milliseconds[i] for i in both]) for score in (self, other))
        return float(mine / theirs)


def contest(
    work: Work,
    entrants: Sequence[Entrant[Scene]],
    slow: set[str],
    few: int,
    clock: Clock = "wall",
    burst: int = 1,
    tick: Callable[[], Any] = lambda: None,
) -> dict[str, Score]:
    """Let every entrant run on every frame.

    Args:
        work: The frames; the first ``WARM_UP`` of them are not counted.
        entrants: Who runs.
        slow: Who runs on few frames only.
        few: On how many; on these the quality of all is measured.
        clock: What counts the time.
        burst: Frames in a turn.
        tick: Called after each frame.

    Returns:
        Name -> score.
    """
    scores = {entrant.name: Score() for entrant in entrants}
    counted = range(WARM_UP, len(work.scenes))
    chosen = {counted[i] for i in np.linspace(0, len(counted) - 1, min(few, len(counted))).astype(int)}
    entered = [replace(each, touch=_touch, frames=chosen if each.name in slow else None) for each in entrants]
    last = 0
    for turn in turns(work.scenes, entered, clock, burst=burst):
        if turn.frame > last:
            tick()
        last = max(last, turn.frame)
        if turn.frame < WARM_UP:
            continue
        scores[turn.name].milliseconds[turn.frame] = turn.milliseconds
        if turn.frame in chosen:
            found = point_quality(work.scenes[turn.frame], turn.result, work.configuration.layout)
            scores[turn.name].quality.append(found)
    return scores


def _touch(scene: Scene) -> None:
    cv2.countNonZero(scene.mask)
    scene.pixels.sum()
