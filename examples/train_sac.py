"""Train SAC on a shape vector: bring a cable, from any start, into one shape, with a dense reward.

Run: ``uv run --extra sim --extra sb3 examples/train_sac.py``; ``--help`` lists the options,
``tensorboard --logdir runs`` draws the curves, and ``--resume`` continues from the last checkpoint.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import torch
import tyro
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import CheckpointCallback, EvalCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecNormalize

from shape_obs import ShapeGoal, ShapeObservation
from shape_obs.policy import deploy_command, save_policy
from shape_obs.training import GoalDifference

HELD_OUT = 1_000_000  # seed of the starts for evaluation; trainings use seeds far below
# 1e-4 m2: coordinates that vary by less than a centimetre are not scaled up. Rewards, which are centimetres, are.
SCALE: dict[str, Any] = {"gamma": 0.95, "epsilon": 1e-4}


@dataclass
class Args:
    """Train a policy, and save it."""

    out: Path = Path("runs/sac")
    steps: int = 10_000
    seed: int = 0
    goal: int = 7  # seed of the goal shape, which grippers can reach
    size: int = 84  # side of the images, pixels
    buffer: int = 50_000  # stored steps
    learning_starts: int = 1000
    evaluate_every: int = 1_000
    starts: int = 20  # number of episodes of an evaluation
    checkpoint_every: int = 5_000
    resume: bool = False  # continue from the last checkpoint


def make_env(size: int, goal: int) -> gym.Env:
    env = gym.make("shape_obs_envs:ShapeObs/Cable-v0", camera=[size, size])
    points = env.reset(seed=goal)[0]["desired_goal"].reshape(-1, 3)  # (20, 3) metres
    return ShapeGoal(ShapeObservation(env), points)


def main(args: Args) -> None:
    torch.set_num_threads(1)  # small networks are no faster with more
    options = {"size": args.size, "goal": args.goal}
    envs = make_vec_env(make_env, env_kwargs=options, seed=args.seed)
    trial = VecNormalize(
        make_vec_env(make_env, env_kwargs=options, seed=HELD_OUT), training=False, norm_reward=False, **SCALE
    )
    if args.resume:  # a checkpoint's statistics are written last
        steps = [int(path.stem.split("_")[-2]) for path in args.out.glob("model_vecnormalize_*_steps.pkl")]
        at = max(steps) if steps else sys.exit(f"--resume: there is no checkpoint in {args.out}")
        env = VecNormalize.load(str(args.out / f"model_vecnormalize_{at}_steps.pkl"), envs)
        model = SAC.load(args.out / f"model_{at}_steps", env, device="cpu")
        model.load_replay_buffer(args.out / f"model_replay_buffer_{at}_steps.pkl")
        model.set_random_seed(args.seed + at)  # not the first starts again
    else:
        env = VecNormalize(envs, **SCALE)
        model = SAC(
            "MultiInputPolicy", env, seed=args.seed, device="cpu", tensorboard_log=str(args.out),
            policy_kwargs={"net_arch": [256, 256], "features_extractor_class": GoalDifference},
            learning_rate=1e-3, batch_size=128, gamma=SCALE["gamma"], tau=0.01, ent_coef="auto_0.01",
            learning_starts=args.learning_starts, buffer_size=args.buffer,
        )  # fmt: skip
    save = CheckpointCallback(args.checkpoint_every, str(args.out), "model", True, True)
    tell = EvalCallback(trial, n_eval_episodes=args.starts, eval_freq=args.evaluate_every)
    model.learn(args.steps - model.num_timesteps, [tell, save], reset_num_timesteps=not args.resume, progress_bar=True)
    save_policy(model, env, args.out / "cable.policy", summary={"algorithm": "SAC", "steps": model.num_timesteps})
    print(f"{args.out / 'cable.policy'}: after {model.num_timesteps} steps, reward {tell.last_mean_reward:.2f}")
    print(f"try it on a simulated robot:\n  {deploy_command(args.out / 'cable.policy')}")


if __name__ == "__main__":
    main(tyro.cli(Args))
