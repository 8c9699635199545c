"""Bring a shape to one goal, with a law that starts without any knowledge of the object."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.features import FeatureVector
from shape_obs.servo import ShapeServo, geometric_weights, make_law
from shape_obs.utils.threads import one_thread
from tests.benchmarks.interleaved_timing import timed
from tests.benchmarks.servo.settings import Setting
from tests.benchmarks.servo.worlds import World
from tests.benchmarks.tables import Row, median

Array = npt.NDArray[np.float64]

STEPS: Final = 200
REACHED: Final = 10.0  # millimetres
_LAST: Final = 5  # steps over which the final error is the mean


Found = Mapping[Setting, Sequence[Row]]


def episodes(setting: Setting, seeds: Sequence[int], steps: int = STEPS) -> Iterator[Row]:
    """Play one episode for each seed, on one thread; an episode that breaks off has a ``failure``.

    Raises:
        ValueError: The setting is not understood.
    """
    made = World(setting)
    try:
        with one_thread():
            for seed in seeds:
                yield _tried(made, setting.law, seed, steps)
    finally:
        made.env.close()


def play(world: World, law: str, seed: int, steps: int = STEPS) -> Row:
    """Bring the shape to the goal of a seed.

    Args:
        world: The world.
        law: A name of ``shape_obs.servo.LAWS``.
        seed: Seed of the start, the goal and the noise.
        steps: Number of steps.

    Returns:
        Errors are mean distances of the true points from the true goal's, in millimetres: ``start_mm`` before the first
        step, ``final_mm`` the mean of the last five steps, ``best_mm`` the smallest one, ``errors_mm`` over time,
        ``(T+1,)``. ``success``: whether ``final_mm`` is below 10; ``steps``: the first step after which the error stays
        below 10 mm, or None. ``prediction``: median share of a change of features that was not predicted, over the
        learnt motions after the excitation until the error stayed below 10 mm (at the goal, changes are only noise),
        None without any. ``seen_mm``: median over the frames of the mean distance of the detected points from the true
        ones; ``detector_ms``: median time of the detector in a frame, None without a detector; ``feature_ms``: that of
        the features of a shape. ``held``: observations without an action. ``blackout_action``: the largest coordinate
        of an action that was chosen in a black frame, ``blackout_mm``: mean distance of the true points from their
        positions in the first black frame, or None. ``start``, ``goal``, ``final``: true points, (N, 3), millimetres,
        base frame.
    """
    servo = _servo(world, law)
    vector = FeatureVector(world.features, [world.spec], world.view)
    observation, info = world.env.reset(seed=seed)
    goal, start = (1e3 * np.asarray(info[name], np.float64) for name in ("truth/goal", "truth/points"))
    errors, points = [1e3 * info["truth/mean_error"]], start
    frames: list[Row] = []
    for _ in range(steps):
        seen, camera = world.seen.points3d, world.view.camera
        assert camera is not None
        _, feature_ms = timed(partial(vector.compute, [world.seen], [world.view]))
        times = {"detector": world.milliseconds, "feature": feature_ms}
        off = None if seen is None else _apart(1e3 * camera.to_base(seen), points)
        frame = Row(before=points, seen=off, dark=world.dark, **times)
        exciting, learnt = servo.exciting, servo.law.learnt
        action = servo.act(observation)
        is_new = servo.law.learnt > learnt and not exciting
        observation, _, _, _, info = world.env.step(action)
        points = 1e3 * info["truth/points"]
        largest, predicted = float(np.abs(action).max()), servo.law.estimator.error if is_new else None
        frames.append(Row(frame, action=largest, predicted=predicted, after=points))
        errors.append(1e3 * info["truth/mean_error"])
    final, there = float(np.mean(errors[-_LAST:])), settled(errors)
    before_goal = frames if there is None else frames[: there + 1]
    black = [frame for frame in frames if frame.dark]
    return Row(
        seed=seed,
        start_mm=errors[0],
        final_mm=final,
        best_mm=min(errors),
        success=final < REACHED,
        steps=there,
        prediction=median(frame.predicted for frame in before_goal),
        seen_mm=median(frame.seen for frame in frames),
        detector_ms=median(frame.detector for frame in frames),
        feature_ms=median(frame.feature for frame in frames),
        held=servo.held,
        blackout_action=max((frame.action for frame in black), default=None),
        blackout_mm=max((_apart(frame.after, black[0].before) for frame in black), default=None),
        errors_mm=np.round(errors, 3).tolist(),
        start=np.round(start, 2).tolist(),
        goal=np.round(goal, 2).tolist(),
        final=np.round(points, 2).tolist(),
        failure="",
    )


def settled(errors: Sequence[float]) -> int | None:
    """Return the first step after which errors ``(T+1,)``, in millimetres, stay below 10, or None."""
    above = np.flatnonzero(np.asarray(errors) >= REACHED)
    first = int(above[-1]) + 1 if len(above) else 0
    return first if first < len(errors) else None


def _tried(world: World, law: str, seed: int, steps: int) -> Row:
    try:
        return play(world, law, seed, steps)
    except (ValueError, RuntimeError, ArithmeticError) as error:
        return Row(seed=seed, failure=f"{type(error).__name__}: {error}")


def _servo(world: World, law: str) -> ShapeServo:
    space = world.env.action_space
    weights = geometric_weights(world.features, world.spec.layout, world.view)
    how: Any = "noise" if weights is None else weights
    vector = FeatureVector(world.features, [world.spec], world.view)
    return ShapeServo(
        make_law(law),
        actions=int(np.prod(space.shape or ())),
        seen=lambda: world.seen,
        measured=lambda: vector.measured([world.seen]),
        weights=how,
        coordinates=world.coordinates,
    )


def _apart(points: Array, others: Array) -> float:
    return float(np.linalg.norm(points - others, axis=1).mean())
