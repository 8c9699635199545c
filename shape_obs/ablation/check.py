"""What is wrong with a study, told before anything runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from shape_obs.ablation.arm import Arm, make_env
from shape_obs.ablation.run import make_model, training_env
from shape_obs.ablation.study import Study


def check(study: Study, arms: Sequence[str] | None = None) -> None:
    """Make every environment and every learner of a study once.

    Args:
        study: What is to be compared.
        arms: Only these.

    Raises:
        ValueError: What is wrong, of all arms.
        ImportError: The extra ``sim`` or ``sb3`` is missing.
    """
    wrong = [
        f"arms.{name}: {complaint}"
        for name in arms or study.arms
        for complaint in [_complaint(lambda name=name: _try(study, study.arms[name]))]
        if complaint
    ]
    if wrong:
        raise ValueError("; ".join(dict.fromkeys(wrong)))


def _try(study: Study, arm: Arm) -> None:
    env = training_env(study, arm, 0)
    try:
        model: Any = make_model(study, arm, env, 0)
        if study.her is not None and model.learning_starts < study.episode:
            raise ValueError(
                f"hyperparameters.learning_starts: hindsight needs a whole episode, {study.episode} steps, "
                f"got {model.learning_starts}."
            )
        env.reset()
    finally:
        env.close()
    plan = study.evaluation
    tried = [None, *([] if arm.observation == "truth" else plan.disturbances.values())]
    for disturbance in tried:
        trial = make_env(arm, study.env, {"reward_type": "sparse", **study.env_arguments}, study.episode, disturbance)
        try:
            simulator: Any = trial.unwrapped
            for difficulty in plan.difficulties:
                simulator.difficulty = difficulty
                _, info = trial.reset(seed=plan.seed)
                if "truth/mean_error" not in info:
                    raise ValueError(f"env: {study.env} does not tell the true error, info['truth/mean_error'].")
        finally:
            trial.close()


def _complaint(attempt: Callable[[], object]) -> str:
    """What it raises; empty where it does not."""
    try:
        attempt()
    except ImportError:
        raise
    except Exception as error:  # noqa: BLE001  learners and environments raise whatever they like
        return f"{type(error).__name__}: {error}" if not isinstance(error, ValueError) else str(error)
    return ""
