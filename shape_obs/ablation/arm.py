"""Arm: what one of the compared policies sees, and the environment that shows it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Literal

from shape_obs.features import Feature
from shape_obs.spec import Spec, SpecError

if TYPE_CHECKING:
    import gymnasium as gym

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
