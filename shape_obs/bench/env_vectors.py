"""Steps per second of several simulated environments at once: in one process, and in one each."""

from __future__ import annotations

import multiprocessing
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from typing import Any, Final

import cv2
import gymnasium as gym
import numpy as np

from shape_obs.bench.env_speed import WARM_UP, Actions, Course, Env, Row, Runner, held_actions, make_env
from shape_obs.bench.interleaved_timing import Entrant, turns
from shape_obs.utils.threads import one_thread
from shape_obs.wrappers import ShapeObservation

WORKERS: Final = 2


def vector_row(course: Course, tick: Callable[[], Any] = lambda: None) -> Row:
    """Steps per second of all environments of a vector together, bare and wrapped, in time that passes.

    Args:
        course: What is run; its clock has no say, since other processes work too.
        tick: Called after each step of all.
    """
    found: dict[str, list[float]] = defaultdict(list)
    with ExitStack() as stack, one_thread():
        runners = {name: Runner(env, course.seed, "wall") for name, env in _contestants(course, stack)}
        (shape,) = {runner.env.action_space.shape for runner in runners.values()}
        assert shape is not None
        actions = held_actions(np.random.default_rng(course.seed), shape, WARM_UP + course.steps)
        entrants = [Entrant[Actions](name, runner.step, runner.ready) for name, runner in runners.items()]
        last = -1
        for turn in turns(actions, entrants, burst=course.burst):
            if turn.frame > last:
                tick()
                last = turn.frame
            if turn.frame >= WARM_UP:
                found[turn.name].append(turn.milliseconds)
    row: Row = {"env": course.env, "image": course.image, "renderer": course.renderer, "workers": WORKERS}
    return row | {name: WORKERS * 1e3 / float(np.median(found[name])) for name in runners}


def _contestants(course: Course, stack: ExitStack) -> Iterator[tuple[str, Any]]:
    for wrapped in (False, True):
        makers = [partial(_made, course.env, course.options, wrapped)] * WORKERS
        name = "wrapped" if wrapped else "bare"
        for kind, env in (
            ("sync", gym.vector.SyncVectorEnv(makers)),
            ("async", gym.vector.AsyncVectorEnv(makers, context=_start_method())),
        ):
            stack.callback(env.close)
            yield f"{kind}_{name}", env


def _start_method() -> str:
    """How workers start: never forked off this process, which may be drawing, and drivers of GPUs do not survive that.

    They are forked off a server where there is one, which has imported everything and drawn nothing.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return "spawn"
    multiprocessing.get_context("forkserver").set_forkserver_preload([__name__, "shape_obs_envs.mujoco.cable"])
    return "forkserver"


def _made(name: Env, options: dict[str, Any], wrapped: bool) -> gym.Env[Any, Any]:
    cv2.setNumThreads(1)
    env = make_env(name, options)
    return ShapeObservation(env) if wrapped else env
