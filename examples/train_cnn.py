"""Learn the task of train_sac_her.py from the image, through a convolutional network, for comparison.

The goal is given in points, and the reward is the simulator's. Each step is much slower.

Run: ``uv run --extra sim --extra sb3 examples/train_cnn.py``; ``--help`` lists the options,
``tensorboard --logdir runs`` draws the curves, and ``--resume`` continues from the last checkpoint.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import torch
import tyro
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.callbacks import CheckpointCallback, EvalCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecNormalize, VecTransposeImage

from shape_obs.policy import save_policy
from shape_obs.training import Curriculum, ImageAndGoal, PixelPolicy, Pixels

HELD_OUT = 1_000_000  # seed of the goals for evaluation; trainings use seeds far below
# The network scales the image. 1e-4 m2: coordinates that vary by less than a centimetre are not scaled up.
FLOOR: dict[str, Any] = {"norm_reward": False, "epsilon": 1e-4, "norm_obs_keys": ["achieved_goal", "desired_goal"]}


@dataclass
class Args:
    """Train a policy, and save it."""

    out: Path = Path("runs/cnn")
    steps: int = 50_000
    seed: int = 0
    size: int = 84  # side of the images, pixels
    buffer: int = 20_000  # stored steps, of two images each: 20,000 steps of 84 x 84 pixels are 0.9 GB
    learning_starts: int = 1000
    evaluate_every: int = 5_000
    goals: int = 30  # number of episodes of an evaluation
    checkpoint_every: int = 10_000
    resume: bool = False  # continue from the last checkpoint


def make_env(size: int) -> gym.Env:
    env = gym.make("shape_obs_envs:ShapeObs/Cable-v0", camera=[size, size], reward_type="sparse")
    return Curriculum(Pixels(env), ["near", "middle", "far"])


def camera(size: int, seed: int) -> VecTransposeImage:
    return VecTransposeImage(make_vec_env(make_env, seed=seed, env_kwargs={"size": size}))  # (C, H, W), as torch has it


def main(args: Args) -> None:
    torch.set_num_threads(1)  # small networks are no faster with more
    envs = camera(args.size, args.seed)
    trial = VecNormalize(camera(args.size, HELD_OUT), training=False, **FLOOR)
    if args.resume:  # a checkpoint's statistics are written last
        steps = [int(path.stem.split("_")[-2]) for path in args.out.glob("model_vecnormalize_*_steps.pkl")]
        at = max(steps) if steps else sys.exit(f"--resume: there is no checkpoint in {args.out}")
        env = VecNormalize.load(str(args.out / f"model_vecnormalize_{at}_steps.pkl"), envs)
        model = SAC.load(args.out / f"model_{at}_steps", env, device="cpu")
        model.load_replay_buffer(args.out / f"model_replay_buffer_{at}_steps.pkl")
        model.set_random_seed(args.seed + at)  # not the first goals again
    else:
        env = VecNormalize(envs, **FLOOR)
        model = SAC(
            PixelPolicy, env, seed=args.seed, device="cpu", tensorboard_log=str(args.out),
            replay_buffer_class=HerReplayBuffer, replay_buffer_kwargs={"n_sampled_goal": 4},
            policy_kwargs={"net_arch": [256, 256], "features_extractor_class": ImageAndGoal},
            learning_rate=3e-4, batch_size=64, train_freq=2, gamma=0.95, tau=0.01, ent_coef="auto_0.1",
            learning_starts=args.learning_starts, buffer_size=args.buffer,
        )  # fmt: skip
    save = CheckpointCallback(args.checkpoint_every, str(args.out), "model", True, True)
    tell = EvalCallback(trial, n_eval_episodes=args.goals, eval_freq=args.evaluate_every)
    model.learn(args.steps - model.num_timesteps, [tell, save], reset_num_timesteps=not args.resume, progress_bar=True)
    save_policy(model, env, args.out / "cable.policy", summary={"algorithm": "SAC", "steps": model.num_timesteps})
    print(f"{args.out / 'cable.policy'}: after {model.num_timesteps} steps, reward {tell.last_mean_reward:.1f}")


if __name__ == "__main__":
    main(tyro.cli(Args))
