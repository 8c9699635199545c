"""The detector beside other ways to the same points: times, ratios and quality, and what is asked of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.bench.asked import at_least, at_most
from shape_obs.bench.backends import LABELS, Backend, backends, ours
from shape_obs.bench.contest import WARM_UP, Score, contest
from shape_obs.bench.peers import PEERS
from shape_obs.bench.turns import Clock, Entrant
from shape_obs.bench.workloads import Name, Scene, Work, work
from shape_obs.detector import ShapeDetector
from shape_obs.utils.threads import one_thread

Row = dict[str, Any]

MINISOM: Final = "minisom, 1000 iterations"
KMEANS: Final = "K-means, n_init 1"
KMEANS_10: Final = "K-means, n_init 10"
KMEANS_OURS: Final = "K-means from our points, 3 iterations"
MIXTURE: Final = "Gaussian mixture"

# (work, how we start, beside whom) -> times faster with NumPy, with Numba.
ASKED: Final[tuple[tuple[Name, str, str, int, int], ...]] = (
    ("rope", "warm", MINISOM, 50, 250),
    ("rope", "warm", KMEANS, 25, 120),
    ("rope", "warm", KMEANS_OURS, 6, 30),
    ("rope", "cold", KMEANS, 10, 20),
    ("cloth", "warm", KMEANS, 150, 1000),
    ("contour", "warm", KMEANS, 8, 15),
)
_LOOKED_AT: Final = 5  # frames for quality where no slow method says how many
_SILHOUETTE_SLACK: Final = 0.006
_SPREAD_SHARE: Final[dict[Name, float]] = {"rope": 0.995, "contour": 0.995, "cloth": 0.96}


@dataclass(frozen=True)
class Result:
    """Of one work.

    Args:
        work: Which, with its frames.
        scores: Method -> what it did, the detector first.
        refused: Frames in which the detector found nothing, all its entrants together.
    """

    work: Work
    scores: Mapping[str, Score]
    refused: int

    @property
    def frames(self) -> int:
        """How many are counted."""
        return len(self.work.scenes) - WARM_UP

    def rows(self) -> list[Row]:
        """One row a method."""
        rows = []
        for name, score in self.scores.items():
            row: Row = {"method": name, "frames": len(score.milliseconds), "median_ms": score.median}
            for backend in LABELS:
                mine = self.scores.get(ours(backend, "warm"))
                row[f"over_{backend}"] = None if mine is None else score.times(mine)
            row |= {"sc": score.mean("silhouette"), "ch": score.mean("calinski_harabasz")}
            rows.append(row | {"spacing_cv": score.mean("spacing")})
        return rows


def missing() -> dict[str, str]:
    """Module -> what to install, for every peer that is not here; and Numba."""
    away = {} if "numba" in backends() else {"numba": "shape-obs[fast]"}
    return away | {peer.module.partition(".")[0]: peer.package for peer in PEERS if peer.load() is None}


def run_work(
    name: Name,
    frames: int,
    slow_frames: int,
    seed: int,
    clock: Clock = "wall",
    burst: int = 1,
    tick: Callable[[], Any] = lambda: None,
) -> Result:
    """Let the detector and every installed peer run on one work.

    Args:
        name: Which work.
        frames: How many are counted.
        slow_frames: On how many of them slow methods run; 0 leaves these out. Quality is looked at on as many.
        seed: Of the motion, and of the methods that draw.
        clock: What counts the time.
        burst: Frames in a turn.
        tick: Called after each frame.
    """
    task = work(name, frames + WARM_UP, seed)
    refused: list[str] = []
    entrants = [_detector(task, backend, start, refused) for start in ("warm", "cold") for backend in backends()]
    entered = [peer for peer in PEERS if name in peer.works and (slow_frames or not peer.slow)]
    modules = [(peer, peer.load()) for peer in entered]
    entrants += [Entrant(peer.name, peer.make(task, module, seed)) for peer, module in modules if module is not None]
    slow = {peer.name for peer in entered if peer.slow}
    with one_thread():
        scores = contest(task, entrants, slow, slow_frames or _LOOKED_AT, clock, burst, tick)
    return Result(task, scores, len(refused))


def claims(results: Mapping[Name, Result]) -> list[Row]:
    """What is asked, what was seen."""
    rows = []
    for name, start, peer, *bounds in ASKED:
        for backend, bound in zip(LABELS, bounds, strict=True):
            what = f"{name}, {start}, {LABELS[backend]}: times faster than {peer}"
            rows.append(at_least(what, bound, _ratio(results.get(name), ours(backend, start), peer)))
    for name, result in results.items():
        rows += _quality(name, result)
    return rows


def _quality(name: Name, result: Result) -> list[Row]:
    mine = result.scores[ours("numpy", "warm")]
    spread = mine.mean("calinski_harabasz")
    rows = []

    def beside(peer: str, share: float) -> Row:
        other = result.scores.get(peer)
        seen = None if other is None else spread / other.mean("calinski_harabasz")
        return at_least(f"{name}: Calinski-Harabasz beside {peer}", share, seen)

    rows.append(beside(KMEANS_10, _SPREAD_SHARE[name]))
    if name != "cloth":
        rows.append(beside(MIXTURE, 1.0))
        best = max(score.mean("silhouette") for score in result.scores.values())
        lost = best - mine.mean("silhouette")
        rows.append(at_most(f"{name}: silhouette below the best", _SILHOUETTE_SLACK, lost, ""))
        theirs = ""
        if KMEANS in result.scores:
            theirs = f" where K-means has {100 * result.scores[KMEANS].mean('spacing'):.0f} %"
        rows.append(at_most(f"{name}: spacing CV{theirs}", 1.0, 100 * mine.mean("spacing"), " %"))
    return rows


def _ratio(result: Result | None, mine: str, peer: str) -> float | None:
    if result is None or mine not in result.scores or peer not in result.scores:
        return None
    return result.scores[peer].times(result.scores[mine])


def _detector(task: Work, backend: Backend, start: str, refused: list[str]) -> Entrant[Scene]:
    """The detector as an entrant; frames without a shape are noted in ``refused``."""
    detector = ShapeDetector([task.configuration], backend=backend)

    def run(scene: Scene) -> npt.NDArray[np.float32]:
        shape = detector.detect_mask(scene.mask).shapes[0]
        if shape.reason:
            refused.append(shape.reason)
        return shape.pixels

    name = ours(backend, start)
    return Entrant(name, run, before=detector.reset) if start == "cold" else Entrant(name, run)
