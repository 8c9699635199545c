"""Define a study, as its YAML file describes it: the arms to compare, how to train them and how to evaluate them."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

from shape_obs.features import Feature
from shape_obs.spec import Spec, SpecError, did_you_mean
from shape_obs.utils.documents import read_yaml

VERSION: Final = 1
_NAME: Final = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789._-")

Algorithm = Literal["SAC", "TD3", "DDPG", "PPO", "A2C"]
OFF_POLICY: Final = ("SAC", "TD3", "DDPG")


@dataclass(frozen=True)
class Disturbance(Spec):
    """Disturb the images in which a trained policy is evaluated.

    Args:
        env: Arguments of the environment, such as ``{"randomize": {"hand": {}}}``.
        noise: Fields of ``D455Model``; None for clean images.
    """

    env: Mapping[str, Any] = field(default_factory=dict)
    noise: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class Arm(Spec):
    """Define the observation of a policy. Reward and score are always distances of points in metres.

    Args:
        observation: ``"shape"``: the shape in the camera's images; ``"truth"``: the points of the simulator;
            ``"pixels"``: the image, through a convolutional network, with the simulator's reward.
        features: Features of the shape and of the goal; None for points.
        shapes: Configurations for ``ShapeObservation``, for example with another number of points; None for those of
            the environment.
        shuffle: Whether to shuffle the points in every frame.
        keep: Keys of vectors in the environment's observation that are appended.
        noise: Fields of ``D455Model`` for the images of training and evaluation; None for clean images.
        env: Arguments of the environment.
        hyperparameters: Hyperparameters of the algorithm; they replace those of the study.

    Raises:
        SpecError: Some values do not fit together.
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
                raise SpecError(f"{wrong[0]}: only for observation='shape', got observation={self.observation!r}.")
        if self.shuffle and (self.features is not None or self.keep or self.observation == "pixels"):
            raise SpecError("shuffle: only points can be shuffled: leave out features, keep and observation='pixels'.")
        if self.keep and (self.features is not None or self.observation == "pixels"):
            raise SpecError("keep: vectors are appended only to points: leave out features and observation='pixels'.")
        if self.noise is not None and self.observation == "truth":
            raise SpecError("noise: the simulator's points have no noise: leave out noise, or observation='truth'.")


@dataclass(frozen=True)
class Evaluation(Spec):
    """Define how policies are evaluated: on held-out goals, the same for all policies.

    Args:
        every: Steps of training between two evaluations.
        goals: Number of goals of each difficulty, in each evaluation except the last.
        final_goals: Number of goals of each difficulty in the last evaluation.
        difficulties: Distances of the goals from the start.
        seed: Seed of the first goal; the other goals have the following seeds. Seeds of trainings are smaller.
        disturbances: Disturbances, by name, under which the final policy is evaluated again; not for arms without
            images.
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
    """Define trainings for every arm and every seed, which differ only in the observation of the policy.

    Args:
        arms: The arms to compare, by name.
        env: A goal-conditioned simulated environment whose reward is in metres.
        env_arguments: Arguments of the environment; the default of ``reward_type`` is ``"sparse"``.
        episode: Steps of an episode.
        difficulties: Difficulties drawn in training; a name that occurs twice is drawn twice as often.
        after: Number of episodes after which the next difficulty is added to the first; 0 draws from all at once.
        seeds: Seeds of the trainings of each arm.
        steps: Steps of a training.
        algorithm: Algorithm of Stable-Baselines3.
        hyperparameters: Hyperparameters of the algorithm, with the names of Stable-Baselines3, and ``net_arch``.
        her: Arguments of ``HerReplayBuffer``; None for no hindsight, as required by PPO and A2C.
        normalize: Arguments of ``VecNormalize``; None for no normalisation.
        evaluation: How policies are evaluated.
        reference: The arm with which the others are compared; None for the first.

    Raises:
        SpecError: A value is missing or out of range, or values do not fit together.
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
                raise SpecError(
                    f"arms: a name is also the name of a folder: expected letters, digits and '._-', got {name!r}."
                )
        if not self.seeds or len(set(self.seeds)) != len(self.seeds):
            raise SpecError(f"seeds: expected at least one seed, all different, got {list(self.seeds)}.")
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
        """Return everything on which the results of a run depend, except its seed."""
        whole = self.to_dict()
        return {
            **{name: value for name, value in whole.items() if name not in ("arms", "seeds", "reference")},
            "arm": whole["arms"][arm],
        }

    def hash(self, arm: str) -> str:
        """Return the SHA-256 hash of ``made_with``."""
        text = json.dumps(self.made_with(arm), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()


def load_study(path: str | os.PathLike[str]) -> Study:
    """Read a study from a YAML file.

    Raises:
        FileNotFoundError: There is no such file.
        SpecError: The file is not YAML, has another version, or is invalid; the message names the place.
    """
    data = read_yaml(Path(path), "study")
    if not isinstance(data, Mapping) or data.get("version") != VERSION:
        got = data.get("version") if isinstance(data, Mapping) else type(data).__name__
        raise SpecError(f"{path}: expected a study with 'version: {VERSION}', got {got!r}.")
    try:
        return Study.from_dict({name: value for name, value in data.items() if name != "version"})
    except SpecError as error:
        raise SpecError(f"{path}: {error}") from error
