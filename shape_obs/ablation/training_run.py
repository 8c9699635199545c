"""Train one policy of a study from its seed, and evaluate it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from shape_obs.ablation.scores import Row, play
from shape_obs.ablation.study import OFF_POLICY, Arm, Disturbance, Study

if TYPE_CHECKING:
    import gymnasium as gym
    from stable_baselines3.common.base_class import BaseAlgorithm

_POINTS: Final = {"kind": "points3d", "frame": "base"}
#: Hyperparameters of the policy, not of the algorithm.
_POLICY: Final = ("net_arch", "activation_fn", "optimizer_kwargs")

Tick = Callable[[int], object]


@dataclass(frozen=True)
class Trained:
    """The result of a training run.

    Attributes:
        rows: Scores of all evaluations.
        ms_per_step: Wall time of training per step of the environment in milliseconds, without evaluations.
        model: The trained model.
        env: The vector environment of the training.
    """

    rows: tuple[Row, ...]
    ms_per_step: float
    model: BaseAlgorithm
    env: Any


def run(study: Study, arm: str, seed: int, tick: Tick = lambda steps: None) -> Trained:
    """Train one policy and evaluate it. Equal arguments give equal scores.

    Args:
        study: The study.
        arm: Name of one of its arms.
        seed: Seed of the training.
        tick: Called after each step with the number of steps so far.

    Raises:
        ValueError: A value in the study is invalid.
        ImportError: The extra ``sb3`` or ``sim`` is missing.
    """
    import torch
    from stable_baselines3.common.callbacks import BaseCallback

    # Each run has one core, and sums of several threads are not reproducible.
    torch.set_num_threads(1)
    spec, plan = study.arms[arm], study.evaluation
    env = training_env(study, spec, seed)
    model = make_model(study, spec, env, seed)
    trial = make_env(spec, study.env, _arguments(study), study.episode)
    seeds = range(plan.seed, plan.seed + plan.final_goals)
    rows: list[Row] = []

    class Evaluate(BaseCallback):
        """Evaluate the policy every ``plan.every`` steps."""

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
    rows.extend(_evaluate_disturbed(study, spec, model, seeds, steps))
    return Trained(tuple(rows), 1e3 * taken / steps, model, env)


def training_env(study: Study, arm: Arm, seed: int) -> Any:
    """Make the vector environment, with one environment, in which an arm is trained."""
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize, VecTransposeImage

    from shape_obs.training import Curriculum

    def make() -> gym.Env[Any, Any]:
        env = make_env(arm, study.env, _arguments(study), study.episode)
        return Monitor(Curriculum(env, study.difficulties, study.after))

    vector: Any = DummyVecEnv([make])
    vector.seed(seed)
    if arm.observation == "pixels":
        vector = VecTransposeImage(
            vector
        )  # inside VecNormalize, since the replay buffer reads unnormalised observations
    if study.normalize is None:
        return vector
    # Images are scaled by the network.
    keys = ["achieved_goal", "desired_goal"] + ([] if arm.observation == "pixels" else ["observation"])
    return VecNormalize(vector, **{"norm_reward": False, "norm_obs_keys": keys, **study.normalize})


def make_model(study: Study, arm: Arm, env: Any, seed: int) -> BaseAlgorithm:
    """Make the model of an arm."""
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
        given.setdefault("buffer_size", study.steps)  # keeps every step
    kind = getattr(sb3, study.algorithm)
    network = PixelPolicy if arm.observation == "pixels" and study.algorithm == "SAC" else "MultiInputPolicy"
    return kind(network, env, policy_kwargs=policy, seed=seed, device="cpu", **given)


def act_of(model: BaseAlgorithm) -> Callable[[Any], Any]:
    """Return a function for the deterministic action of a model, given an observation of a single environment."""
    normalize = model.get_vec_normalize_env()

    def act(observation: Mapping[str, Any]) -> Any:
        # A batch of one, since normalisation and policy expect observations of a vector environment.
        batch: Any = {key: value[None] for key, value in observation.items()}
        if normalize is not None:
            batch = normalize.normalize_obs(batch)
        return model.predict(batch, deterministic=True)[0][0]

    return act


def _evaluate_disturbed(study: Study, arm: Arm, model: BaseAlgorithm, seeds: range, steps: int) -> Iterable[Row]:
    plan = study.evaluation
    if arm.observation == "truth":
        return  # it does not read images
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


def make_env(
    arm: Arm, name: str, arguments: Mapping[str, Any], steps: int, disturbance: Disturbance | None = None
) -> gym.Env[Any, Any]:
    """Make the environment with the observation of an arm.

    Args:
        arm: The arm.
        name: A simulated environment with goals, such as ``"ShapeObs/Cable-v0"``.
        arguments: Arguments of the environment; those of the arm and then of the disturbance replace them.
        steps: Steps of an episode.
        disturbance: Disturbance of the images.

    Returns:
        A goal-conditioned environment. If it has the attribute ``visible``, a policy may read only so many numbers
        of a goal.

    Raises:
        ValueError: An argument is invalid.
    """
    import gymnasium as gym

    from shape_obs.training import Pixels, PointReward, Shuffled, TrueState
    from shape_obs.wrappers import ShapeGoal, ShapeObservation

    disturbance = disturbance or Disturbance()
    options = {**arguments, **arm.env, **disturbance.env}
    env: Any
    if arm.observation == "truth":
        options |= {"render_observation": False}
    env = gym.make(_qualified(name), max_episode_steps=steps, disable_env_checker=True, **options)
    noise = (
        None if arm.noise is None and disturbance.noise is None else {**(arm.noise or {}), **(disturbance.noise or {})}
    )
    if noise is not None and arm.observation != "truth":
        from shape_obs_envs.d455 import D455Noise

        env = D455Noise(env, noise)
    if arm.observation == "truth":
        env = TrueState(env, arm.keep)
    elif arm.observation == "pixels":
        env = Pixels(env)
    elif arm.features is None:
        env = ShapeObservation(env, arm.shapes, features=[_POINTS], keep=list(arm.keep) or None)
    else:
        features = [*(feature.to_dict() for feature in arm.features), _POINTS]
        env = ShapeObservation(env, arm.shapes, features=features)
        # The threshold of ShapeGoal has no effect: PointReward has its own, in metres.
        simulator: Any = env.unwrapped
        env = ShapeGoal(env, features=features, threshold=1.0)
        env = PointReward(env, simulator.reward_type, simulator.success_threshold)
    return Shuffled(env) if arm.shuffle else env


def _qualified(name: str) -> str:
    """Add the module that registers this package's environments, if the name is one of them."""
    return f"shape_obs_envs:{name}" if name.startswith("ShapeObs/") else name
