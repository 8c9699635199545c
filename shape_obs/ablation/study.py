"""Arm: what one of the compared policies sees, and the environment that shows it.

Study: what an ablation compares, as its YAML file says it.
"""

from __future__ import annotations
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Literal
from shape_obs.features import Feature
from shape_obs.spec import Spec, SpecError
if TYPE_CHECKING:
    import gymnasium as gym
import hashlib
import json
import os
from pathlib import Path
from typing import Any, Final, Literal
from shape_obs.spec import Spec, SpecError, did_you_mean
from shape_obs.utils.documents import read_yaml


_POINTS: Final = {"kind": "points3d", "frame": "base"}



@dataclass(frozen=True)
class Disturbance(Spec):
    """What goes wrong in the images in which a policy is tried out.

    Args:
        env: Arguments of the environment, such as ``{"randomize": {"hand": {}}}``.
        noise: Fields of ``D455Model``; None for clean images.
    """

    env: Mapping[str, Any] = field(default_factory=dict)
    noise: Mapping[str, Any] | None = None



@dataclass(frozen=True)
class Arm(Spec):
    """What a policy sees. Whatever that is, its reward is of the points in metres, and so is its score.

    Args:
        observation: ``"shape"``: what the camera sees of the shape; ``"truth"``: the simulator's points;
            ``"pixels"``: the image, through a convolutional network, whose reward comes from the simulator.
        features: Of the shape, seen and desired; None for its points.
        shapes: Configurations for ``ShapeObservation``, such as one of another number of points; None for the env's.
        shuffle: Show the points in another order in every frame.
        keep: Keys of vectors of the env's observation to show beside.
        noise: Fields of ``D455Model``, in whose images to train and to be tried; None for clean images.
        env: Arguments of the environment.
        hyperparameters: Of the algorithm, beside and over those of the study.

    Raises:
        SpecError: Things that do not go together.
    """

    observation: Literal["shape", "truth", "pixels"] = "shape"
    features: tuple[Feature, ...] | None = None
    shapes: tuple[Mapping[str, Any], ...] | None = None
    shuffle: bool = False
    keep: tuple[str, ...] = ()
    noise: Mapping[str, Any] | None = None
    env: Mapping[str, Any] = field(default_factory=dict)
    hyperparameters: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.observation != "shape":
            wrong = [name for name in ("features", "shapes") if getattr(self, name) is not None]
            if wrong:
                raise SpecError(f"{wrong[0]}: only observation='shape' has them, got observation={self.observation!r}.")
        if self.shuffle and (self.features is not None or self.keep or self.observation == "pixels"):
            raise SpecError("shuffle: only points can be shuffled: leave out features, keep and observation='pixels'.")
        if self.keep and (self.features is not None or self.observation == "pixels"):
            raise SpecError("keep: only points are shown with something beside: leave out features and pixels.")
        if self.noise is not None and self.observation == "truth":
            raise SpecError("noise: the simulator's points have none: leave it out, or observation='truth'.")



def make_env(
    arm: Arm, name: str, arguments: Mapping[str, Any], steps: int, disturbance: Disturbance | None = None
) -> gym.Env[Any, Any]:
    """The environment as an arm shows it.

    Args:
        arm: What is shown.
        name: A simulated environment with goals, ``"ShapeObs/Cable-v0"``.
        arguments: Of the environment; those of the arm, then of the disturbance, come over them.
        steps: Of an episode.
        disturbance: Of the images.

    Returns:
        A goal-conditioned environment; where it has ``visible``, no more numbers of a goal may be read.

    Raises:
        ValueError: Something of it is not understood.
    """
    import gymnasium as gym

    from shape_obs.training import Pixels, PointReward, Shuffled, TrueState
    from shape_obs.wrappers import ShapeGoal, ShapeObservation

    wrong = disturbance or Disturbance()
    options = {**arguments, **arm.env, **wrong.env}
    env: Any
    if arm.observation == "truth":
        options |= {"render_observation": False}
    env = gym.make(_qualified(name), max_episode_steps=steps, disable_env_checker=True, **options)
    noise = None if arm.noise is None and wrong.noise is None else {**(arm.noise or {}), **(wrong.noise or {})}
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
        # Nothing reads ShapeGoal's threshold: PointReward has its own, in metres.
        simulator: Any = env.unwrapped
        env = ShapeGoal(env, features=features, threshold=1.0)
        env = PointReward(env, simulator.reward_type, simulator.success_threshold)
    return Shuffled(env) if arm.shuffle else env



def _qualified(name: str) -> str:
    """With the module that registers it, where the name tells none."""
    return f"shape_obs_envs:{name}" if name.startswith("ShapeObs/") else name



VERSION: Final = 1

_NAME: Final = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789._-")


Algorithm = Literal["SAC", "TD3", "DDPG", "PPO", "A2C"]

OFF_POLICY: Final = ("SAC", "TD3", "DDPG")



@dataclass(frozen=True)
class Evaluation(Spec):
    """How policies are tried out: on goals that no training sees, the same for all.

    Args:
        every: Steps of training between two evaluations.
        goals: Of each difficulty, in each evaluation but the last.
        final_goals: Of each difficulty, in the last.
        difficulties: How far goals are from the start.
        seed: Of the first goal; the others count on. Trainings have seeds far below.
        disturbances: In which the last policy is tried out besides, by name; an arm that sees no images is not.
    """

    every: int = 2500
    goals: int = 20
    final_goals: int = 100
    difficulties: tuple[str, ...] = ("near", "middle", "far")
    seed: int = 1_000_000
    disturbances: Mapping[str, Disturbance] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("every", "goals", "final_goals"):
            if getattr(self, name) < 1:
                raise SpecError(f"evaluation.{name}: expected at least 1, got {getattr(self, name)}.")
        if not self.difficulties:
            raise SpecError("evaluation.difficulties: expected at least one.")



@dataclass(frozen=True)
class Study(Spec):
    """Arms × seeds: trainings that differ in what the policy sees, and in nothing else.

    Args:
        arms: What is compared, by name.
        env: A goal-conditioned simulated environment, its reward in metres.
        env_arguments: Of the environment; ``reward_type`` is ``"sparse"`` unless they say otherwise.
        episode: Steps of an episode.
        difficulties: Drawn from in training; a name that stands twice is drawn twice as often.
        after: Episodes after which one more of these joins the first; 0 draws from all of them at once.
        seeds: Of the trainings of each arm.
        steps: Of a training.
        algorithm: Of Stable-Baselines3.
        hyperparameters: Of the algorithm, as Stable-Baselines3 names them; ``net_arch`` too.
        her: Arguments of ``HerReplayBuffer``; None for no hindsight, and always with PPO and A2C.
        normalize: Arguments of ``VecNormalize``; None for none.
        evaluation: How policies are tried out.
        reference: The arm that the others are compared with; None for the first.

    Raises:
        SpecError: Something is missing, out of range, or does not fit together.
    """

    arms: Mapping[str, Arm]
    env: str = "ShapeObs/Cable-v0"
    env_arguments: Mapping[str, Any] = field(default_factory=dict)
    episode: int = 50
    difficulties: tuple[str, ...] = ("near", "middle", "far")
    after: int = 0
    seeds: tuple[int, ...] = (0, 1, 2)
    steps: int = 20_000
    algorithm: Algorithm = "SAC"
    hyperparameters: Mapping[str, Any] = field(default_factory=dict)
    her: Mapping[str, Any] | None = None
    normalize: Mapping[str, Any] | None = None
    evaluation: Evaluation = field(default_factory=Evaluation)
    reference: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.arms:
            raise SpecError("arms: expected at least one, got none.")
        for name in self.arms:
            if not name or not set(name) <= _NAME or name.startswith("."):
                raise SpecError(f"arms: a name is a folder's too: letters, digits and '._-', got {name!r}.")
        if not self.seeds or len(set(self.seeds)) != len(self.seeds):
            raise SpecError(f"seeds: expected different ones, at least one, got {list(self.seeds)}.")
        if min(self.seeds) < 0 or max(self.seeds) >= self.evaluation.seed:
            raise SpecError(f"seeds: expected 0 ... evaluation.seed - 1, got {list(self.seeds)}.")
        for name in ("steps", "episode"):
            if getattr(self, name) < 1:
                raise SpecError(f"{name}: expected at least 1, got {getattr(self, name)}.")
        if not self.difficulties:
            raise SpecError("difficulties: expected at least one.")
        if self.her is not None and self.algorithm not in OFF_POLICY:
            raise SpecError(f"her: hindsight replay needs one of {', '.join(OFF_POLICY)}, got {self.algorithm}.")
        if self.reference is not None and self.reference not in self.arms:
            raise SpecError(f"reference: no arm {self.reference!r}{did_you_mean(self.reference, self.arms)}")

    def made_with(self, arm: str) -> dict[str, Any]:
        """All that the numbers of a run depend on, but its seed."""
        whole = self.to_dict()
        return {
            **{name: value for name, value in whole.items() if name not in ("arms", "seeds", "reference")},
            "arm": whole["arms"][arm],
        }

    def hash(self, arm: str) -> str:
        """SHA-256 of ``made_with``."""
        text = json.dumps(self.made_with(arm), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()



def load_study(path: str | os.PathLike[str]) -> Study:
    """Read a study from a YAML file.

    Raises:
        FileNotFoundError: There is no such file.
        SpecError: It is no YAML, of another version, or not understood; the message names the place.
    """
    data = read_yaml(Path(path), "study")
    if not isinstance(data, Mapping) or data.get("version") != VERSION:
        got = data.get("version") if isinstance(data, Mapping) else type(data).__name__
        raise SpecError(f"{path}: expected a study with 'version: {VERSION}', got {got!r}.")
    try:
        return Study.from_dict({name: value for name, value in data.items() if name != "version"})
    except SpecError as error:
        raise SpecError(f"{path}: {error}") from error

