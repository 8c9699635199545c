"""One training of an ablation, from its seed to its scores."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from shape_obs.ablation.study import Arm
from shape_obs.ablation.study import make_env
from shape_obs.ablation.scores import Score
from shape_obs.ablation.scores import play
from shape_obs.ablation.study import OFF_POLICY, Study

if TYPE_CHECKING:
    import gymnasium as gym
    from stable_baselines3.common.base_class import BaseAlgorithm

#: Arguments that go to the policy, not to the algorithm.
_POLICY: Final = ("net_arch", "activation_fn", "optimizer_kwargs")

Tick = Callable[[int], object]


@dataclass(frozen=True)
class Row:
    """Scores at one time of a training.

    Attributes:
        steps: Steps of training before.
        disturbance: In which the policy was tried out; empty for none.
        score: Of one episode.
    """

    steps: int
    disturbance: str
    score: Score


@dataclass(frozen=True)
class Trained:
    """What came out of a run.

    Attributes:
        rows: Scores of all evaluations.
        ms_per_step: Wall time of training for each step of the env, milliseconds, without evaluations.
        model: The policy.
        env: The vector environment that it was trained in.
    """

    rows: tuple[Row, ...]
    ms_per_step: float
    model: BaseAlgorithm
    env: Any


def run(study: Study, arm: str, seed: int, tick: Tick = lambda steps: None) -> Trained:
    """Train one policy and try it out; equal arguments give equal scores.

    Args:
        study: What is compared.
        arm: Name of one of its arms.
        seed: Of the training.
        tick: Called with the number of steps after each of them.

    Raises:
        ValueError: Something of the study is not understood.
        ImportError: The extra ``sb3`` or ``sim`` is missing.
    """
    import torch
    from stable_baselines3.common.callbacks import BaseCallback

    # One run a core; and sums in threads come out differently.
    torch.set_num_threads(1)
    spec, plan = study.arms[arm], study.evaluation
    env = training_env(study, spec, seed)
    model = make_model(study, spec, env, seed)
    trial = make_env(spec, study.env, _arguments(study), study.episode)
    seeds = range(plan.seed, plan.seed + plan.final_goals)
    rows: list[Row] = []

    class Evaluate(BaseCallback):
        """Tries the policy out now and then."""

        seconds = 0.0

        def _on_step(self) -> bool:
            tick(self.num_timesteps)
            if self.num_timesteps % plan.every == 0 and self.num_timesteps < study.steps:
                begin = time.perf_counter()
                scores = play(trial, act_of(self.model), plan.difficulties, seeds[: plan.goals], study.episode)
                rows.extend(Row(self.num_timesteps, "", score) for score in scores)
                self.seconds += time.perf_counter() - begin
            return True

    evaluate = Evaluate()
    begin = time.perf_counter()
    try:
        model.learn(study.steps, callback=evaluate)
        taken = time.perf_counter() - begin - evaluate.seconds
        steps = model.num_timesteps
        scores = play(trial, act_of(model), plan.difficulties, seeds, study.episode)
        rows.extend(Row(steps, "", score) for score in scores)
    finally:
        trial.close()
    rows.extend(_disturbed(study, spec, model, seeds, steps))
    return Trained(tuple(rows), 1e3 * taken / steps, model, env)


def training_env(study: Study, arm: Arm, seed: int) -> Any:
    """The vector environment that an arm is trained in, of one environment."""
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize, VecTransposeImage

    from shape_obs.training import Curriculum

    def make() -> gym.Env[Any, Any]:
        env = make_env(arm, study.env, _arguments(study), study.episode)
        return Monitor(Curriculum(env, study.difficulties, study.after))

    vector: Any = DummyVecEnv([make])
    vector.seed(seed)
    if arm.observation == "pixels":
        vector = VecTransposeImage(vector)  # before it is normalised: the replay buffer asks for what came before that
    if study.normalize is None:
        return vector
    # Images are scaled by the network.
    keys = ["achieved_goal", "desired_goal"] + ([] if arm.observation == "pixels" else ["observation"])
    return VecNormalize(vector, **{"norm_reward": False, "norm_obs_keys": keys, **study.normalize})


def make_model(study: Study, arm: Arm, env: Any, seed: int) -> BaseAlgorithm:
    """The algorithm that is to learn."""
    import stable_baselines3 as sb3

    from shape_obs.training import GoalDifference, ImageAndGoal, PixelPolicy

    given = {**study.hyperparameters, **arm.hyperparameters}
    policy: dict[str, Any] = {name: given.pop(name) for name in _POLICY if name in given}
    if arm.observation == "pixels":
        policy["features_extractor_class"] = ImageAndGoal
    else:
        visible = env.env_method("get_wrapper_attr", "visible")[0] if _has_visible(env) else None
        policy |= {"features_extractor_class": GoalDifference, "features_extractor_kwargs": {"visible": visible}}
    if study.her is not None:
        given |= {"replay_buffer_class": sb3.HerReplayBuffer, "replay_buffer_kwargs": dict(study.her)}
    if study.algorithm in OFF_POLICY:
        given.setdefault("buffer_size", study.steps)  # nothing is ever forgotten
    kind = getattr(sb3, study.algorithm)
    network = PixelPolicy if arm.observation == "pixels" and study.algorithm == "SAC" else "MultiInputPolicy"
    return kind(network, env, policy_kwargs=policy, seed=seed, device="cpu", **given)


def act_of(model: BaseAlgorithm) -> Callable[[Any], Any]:
    """What the policy does, without exploring, for an observation of the environment itself."""
    normalize = model.get_vec_normalize_env()

    def act(observation: Mapping[str, Any]) -> Any:
        # A batch of one: normalisation and policy take a vector environment's observations.
        batch: Any = {key: value[None] for key, value in observation.items()}
        if normalize is not None:
            batch = normalize.normalize_obs(batch)
        return model.predict(batch, deterministic=True)[0][0]

    return act


def _disturbed(study: Study, arm: Arm, model: BaseAlgorithm, seeds: range, steps: int) -> Iterable[Row]:
    plan = study.evaluation
    if arm.observation == "truth":
        return  # sees no images
    for name, disturbance in plan.disturbances.items():
        env = make_env(arm, study.env, _arguments(study), study.episode, disturbance)
        try:
            for score in play(env, act_of(model), plan.difficulties, seeds, study.episode):
                yield Row(steps, name, score)
        finally:
            env.close()


def _arguments(study: Study) -> dict[str, Any]:
    return {"reward_type": "sparse", **study.env_arguments}


def _has_visible(env: Any) -> bool:
    return bool(env.env_method("has_wrapper_attr", "visible")[0])
