"""Train PPO on a shape vector: bring a cable, from any start, into one shape, in four envs at once.

Run: ``uv run --extra sim --extra sb3 examples/train_ppo.py``; ``--help`` lists the options,
``tensorboard --logdir runs`` draws the curves, and ``--resume`` continues from the last checkpoint.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import gymnasium as gym
import torch
import tyro
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import CheckpointCallback, EvalCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import SubprocVecEnv, VecNormalize

from shape_obs import ShapeGoal, ShapeObservation
from shape_obs.policy import deploy_command, save_policy
from shape_obs.training import GoalDifference

HELD_OUT = 1_000_000  # seed of the starts for evaluation; trainings use seeds far below
# 1e-4 m2: coordinates that vary by less than a centimetre are not scaled up. Rewards, which are centimetres, are.
SCALE: dict[str, Any] = {"gamma": 0.95, "epsilon": 1e-4}


@dataclass
class Args:
    """Train a policy, and save it."""

    out: Path = Path("runs/ppo")
    steps: int = 100_000
    seed: int = 0
    goal: int = 7  # seed of the goal shape, which grippers can reach
    size: int = 84  # side of the images, pixels
    envs: int = 4
    start_method: Literal["forkserver", "spawn", "fork"] | None = None  # of one process per env; None: no processes
    rollout: int = 256  # steps of each env between two updates
    evaluate_every: int = 10_000
    starts: int = 20  # number of episodes of an evaluation
    checkpoint_every: int = 50_000
    resume: bool = False  # continue from the last checkpoint


def make_env(size: int, goal: int) -> gym.Env:
    env = gym.make("shape_obs_envs:ShapeObs/Cable-v0", camera=[size, size])
    points = env.reset(seed=goal)[0]["desired_goal"].reshape(-1, 3)  # (20, 3) metres
    return ShapeGoal(ShapeObservation(env), points)


def main(args: Args) -> None:
    torch.set_num_threads(1)  # small networks are no faster with more
    options = {"size": args.size, "goal": args.goal}
    apart = {"vec_env_cls": SubprocVecEnv, "vec_env_kwargs": {"start_method": args.start_method}}
    envs = make_vec_env(make_env, args.envs, args.seed, env_kwargs=options, **(apart if args.start_method else {}))
    trial = VecNormalize(
        make_vec_env(make_env, env_kwargs=options, seed=HELD_OUT), training=False, norm_reward=False, **SCALE
    )
    if args.resume:  # a checkpoint's statistics are written last
        steps = [int(path.stem.split("_")[-2]) for path in args.out.glob("model_vecnormalize_*_steps.pkl")]
        at = max(steps) if steps else sys.exit(f"--resume: there is no checkpoint in {args.out}")
        env = VecNormalize.load(str(args.out / f"model_vecnormalize_{at}_steps.pkl"), envs)
        model = PPO.load(args.out / f"model_{at}_steps", env, device="cpu")
        model.set_random_seed(args.seed + at)  # not the first starts again
    else:
        env = VecNormalize(envs, **SCALE)
        model = PPO(
            "MultiInputPolicy", env, seed=args.seed, device="cpu", tensorboard_log=str(args.out),
            n_steps=args.rollout, batch_size=128, n_epochs=10, gamma=SCALE["gamma"], gae_lambda=0.9,
            learning_rate=3e-4, ent_coef=0.0, policy_kwargs={"features_extractor_class": GoalDifference},
        )  # fmt: skip
    save = CheckpointCallback(args.checkpoint_every // args.envs, str(args.out), "model", save_vecnormalize=True)
    tell = EvalCallback(trial, n_eval_episodes=args.starts, eval_freq=args.evaluate_every // args.envs)
    model.learn(args.steps - model.num_timesteps, [tell, save], reset_num_timesteps=not args.resume, progress_bar=True)
    save_policy(model, env, args.out / "cable.policy", summary={"algorithm": "PPO", "steps": model.num_timesteps})
    print(f"{args.out / 'cable.policy'}: after {model.num_timesteps} steps, reward {tell.last_mean_reward:.2f}")
    print(f"try it on a simulated robot:\n  {deploy_command(args.out / 'cable.policy')}")


if __name__ == "__main__":
    main(tyro.cli(Args))
