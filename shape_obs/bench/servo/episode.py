"""One goal: a law that knows nothing yet, and so many steps."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.bench.servo.settings import Setting
from shape_obs.bench.servo.worlds import World, world
from shape_obs.features import FeatureVector
from shape_obs.servo import ShapeServo, geometric_weights, make_law
from shape_obs.utils.threads import one_thread

Array = npt.NDArray[np.float64]

STEPS: Final = 200
REACHED: Final = 10.0  # millimetres
_LAST: Final = 5  # steps over which the final error is the mean


@dataclass(frozen=True)
class Episode:
    """How one goal was approached. Errors are mean distances of the true points from the true goal's, millimetres.

    Args:
        seed: Of the start, the goal and the noise.
        start_mm: Error before the first step.
        final_mm: Mean error of the last five steps.
        best_mm: The smallest error on the way.
        success: ``final_mm`` is below 10.
        steps: The first step after which the error stays below 10 mm; None where it does not.
        prediction: Median share of a change of features that was not foreseen, over the motions after the excitation
            that were learnt from until the error stayed below 10 mm: at the goal all that changes is noise. None where
            there were none.
        seen_mm: Median over the frames of the mean distance of the points that the law was shown from the true ones;
            frames before the shape was first found have none.
        detector_ms: Median time of the detector in a frame; None without one.
        feature_ms: Median time of the features of a shape.
        held: Observations that were not acted on.
        blackout_action: The largest coordinate of an action that was chosen in the dark; None where it never was dark.
        blackout_mm: How far the true points came from where they were in the first dark frame, mean over the points.
        errors_mm: (T+1,) over time.
        start: (N,3) true points at the start, millimetres, base frame.
        goal: (N,3) true goal.
        final: (N,3) true points at the end.
        failure: Why the episode broke off; empty if it did not. All numbers are None or empty then.
    """

    seed: int
    start_mm: float | None = None
    final_mm: float | None = None
    best_mm: float | None = None
    success: bool = False
    steps: int | None = None
    prediction: float | None = None
    seen_mm: float | None = None
    detector_ms: float | None = None
    feature_ms: float | None = None
    held: int = 0
    blackout_action: float | None = None
    blackout_mm: float | None = None
    errors_mm: tuple[float, ...] = ()
    start: tuple[tuple[float, ...], ...] = ()
    goal: tuple[tuple[float, ...], ...] = ()
    final: tuple[tuple[float, ...], ...] = ()
    failure: str = ""

    def to_dict(self) -> dict[str, Any]:
        """JSON-able."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Episode:
        """Back from JSON."""
        lines = {name: tuple(map(tuple, values[name])) for name in ("start", "goal", "final")}
        return cls(**{**values, **lines, "errors_mm": tuple(values["errors_mm"])})


def episodes(setting: Setting, seeds: Sequence[int], steps: int = STEPS) -> Iterator[Episode]:
    """One episode for each seed, on one thread. What breaks off is told in ``failure``, and the next one begins.

    Raises:
        ValueError: A setting that is not understood.
    """
    made = world(setting)
    try:
        with one_thread():
            for seed in seeds:
                yield _tried(made, setting.law, seed, steps)
    finally:
        made.env.close()


def play(world: World, law: str, seed: int, steps: int = STEPS) -> Episode:
    """Bring the shape to the goal of a seed.

    Args:
        world: Where.
        law: A name of ``shape_obs.servo.LAWS``.
        seed: Of the start, the goal and the noise.
        steps: How many.
    """
    servo = _servo(world, law)
    vector = FeatureVector(world.features, [world.spec], world.view())
    observation, info = world.env.reset(seed=seed)
    goal, start = 1e3 * info["truth/goal"], 1e3 * info["truth/points"]
    errors, points, blackout = [1e3 * info["truth/mean_error"]], start, _Blackout()
    foreseen: list[tuple[int, float]] = []
    seen: list[float] = []
    detector: list[float | None] = []
    feature: list[float] = []
    for step in range(steps):
        seen.append(_apart(world, points))
        detector.append(world.milliseconds())
        feature.append(_milliseconds(vector, world))
        exciting, learnt = servo.exciting, servo.law.learnt
        action = servo.act(observation)
        if servo.law.learnt > learnt and not exciting:
            foreseen.append((step, servo.law.estimator.error))
        dark = world.dark()
        observation, _, _, _, info = world.env.step(action)
        if dark:
            blackout.watch(action, points, 1e3 * info["truth/points"])
        points = 1e3 * info["truth/points"]
        errors.append(1e3 * info["truth/mean_error"])
    final, there = float(np.mean(errors[-_LAST:])), settled(errors)
    on_the_way = [error for step, error in foreseen if there is None or step <= there]
    return Episode(
        seed=seed,
        start_mm=errors[0],
        final_mm=final,
        best_mm=min(errors),
        success=final < REACHED,
        steps=there,
        prediction=_median(on_the_way),
        seen_mm=_median(seen),
        detector_ms=_median(detector),
        feature_ms=_median(feature),
        held=servo.held,
        blackout_action=blackout.action,
        blackout_mm=blackout.moved,
        errors_mm=tuple(np.round(errors, 3).tolist()),
        start=_listed(start),
        goal=_listed(goal),
        final=_listed(points),
    )


def settled(errors: Sequence[float]) -> int | None:
    """The first step after which errors (T+1,), millimetres, stay below 10; None where they do not."""
    above = np.flatnonzero(np.asarray(errors) >= REACHED)
    first = int(above[-1]) + 1 if len(above) else 0
    return first if first < len(errors) else None


def _tried(world: World, law: str, seed: int, steps: int) -> Episode:
    try:
        return play(world, law, seed, steps)
    except (ValueError, RuntimeError, ArithmeticError) as error:
        return Episode(seed, failure=f"{type(error).__name__}: {error}")


class _Blackout:
    """The largest motion while it is dark."""

    def __init__(self) -> None:
        self.action: float | None = None
        self.moved: float | None = None
        self._before: Array | None = None

    def watch(self, action: npt.NDArray[np.float32], before: Array, after: Array) -> None:
        """A step that was chosen in the dark, and the true points before and after it."""
        self._before = before if self._before is None else self._before
        moved = float(np.linalg.norm(after - self._before, axis=1).mean())
        self.action = max(self.action or 0.0, float(np.abs(action).max()))
        self.moved = max(self.moved or 0.0, moved)


def _median(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None and np.isfinite(value)]
    return float(np.median(known)) if known else None


def _servo(world: World, law: str) -> ShapeServo:
    space = world.env.action_space
    weights = geometric_weights(world.features, world.spec.layout, world.view())
    how: Any = "noise" if weights is None else weights
    vector = FeatureVector(world.features, [world.spec], world.view())
    return ShapeServo(
        make_law(law),
        actions=int(np.prod(space.shape or ())),
        seen=world.seen,
        measured=lambda: vector.measured([world.seen()]),
        weights=how,
    )


def _milliseconds(vector: FeatureVector, world: World) -> float:
    shape, view = [world.seen()], [world.view()]
    begin = time.perf_counter()
    vector.compute(shape, view)
    return 1e3 * (time.perf_counter() - begin)


def _apart(world: World, truth: Array) -> float:
    """Mean distance of the seen points from the true ones, millimetres."""
    points, camera = world.seen().points3d, world.view().camera
    assert points is not None
    assert camera is not None
    return float(np.linalg.norm(1e3 * camera.to_base(points) - truth, axis=1).mean())


def _listed(points: npt.NDArray[Any]) -> tuple[tuple[float, ...], ...]:
    return tuple(map(tuple, np.round(points.astype(np.float64), 2).tolist()))
