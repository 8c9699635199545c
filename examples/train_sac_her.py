"""Train SAC with hindsight replay on ordered points: bring a rope with two grippers into any shape, seen by a camera.

Run: ``uv run --extra sim --extra sb3 examples/train_sac_her.py``; ``--help`` lists the options. ``--resume`` continues.
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
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecNormalize, sync_envs_normalization

from shape_obs import ShapeObservation
from shape_obs.policy import deploy_command, save_policy
from shape_obs.training import Curriculum, GoalDifference

GOALS = ("near", "middle", "far")
HELD_OUT = 1_000_000  # seed of the goals for evaluation; trainings use seeds far below
FLOOR: dict[str, Any] = {"norm_reward": False, "epsilon": 1e-4}  # m2: less than a centimetre is not scaled up


@dataclass
class Args:
    """Train a policy, and save it."""

    env: str = "Cable"  # or Hanging: a rope in the air, with grippers that move in x, y and z
    out: Path = Path("runs/sac_her")
    steps: int = 25_000
    seed: int = 0
    camera: tuple[int, int] = (160, 120)  # width and height of the images, pixels; smaller ones learn slower
    buffer: int = 50_000  # stored steps
    learning_starts: int = 1000
    evaluate_every: int = 2_500
    goals: int = 30  # number of episodes of an evaluation
    checkpoint_every: int = 10_000
    resume: bool = False  # continue from the last checkpoint


def make_env(args: Args, difficulties: tuple[str, ...]) -> gym.Env:
    options: dict[str, Any] = {"step": 0.01} if args.env == "Hanging" else {}  # m: steps of 5 cm learn far slower
    env = gym.make(f"shape_obs_envs:ShapeObs/{args.env}-v0", camera=list(args.camera), reward_type="sparse", **options)
    return Curriculum(ShapeObservation(env), difficulties)


def held_out(args: Args, *goals: str) -> VecNormalize:
    envs = make_vec_env(make_env, env_kwargs={"args": args, "difficulties": goals}, seed=HELD_OUT)
    return VecNormalize(envs, training=False, **FLOOR)


def main(args: Args) -> None:
    torch.set_num_threads(1)  # small networks are no faster with more
    envs = make_vec_env(make_env, env_kwargs={"args": args, "difficulties": GOALS}, seed=args.seed)
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
            "MultiInputPolicy", env, seed=args.seed, device="cpu", tensorboard_log=str(args.out),
            replay_buffer_class=HerReplayBuffer, replay_buffer_kwargs={"n_sampled_goal": 4},
            policy_kwargs={"net_arch": [256, 256], "features_extractor_class": GoalDifference},
            learning_rate=1e-3, batch_size=128, gamma=0.95, tau=0.01, ent_coef="auto_0.1",
            learning_starts=args.learning_starts, buffer_size=args.buffer,
        )  # fmt: skip
    save = CheckpointCallback(args.checkpoint_every, str(args.out), "model", True, True)
    tell = EvalCallback(held_out(args, *GOALS), n_eval_episodes=args.goals, eval_freq=args.evaluate_every)
    model.learn(args.steps - model.num_timesteps, [tell, save], reset_num_timesteps=not args.resume, progress_bar=True)
    reached: list[bool] = []
    for goals in GOALS:
        sync_envs_normalization(env, trial := held_out(args, goals))
        evaluate_policy(model, trial, args.goals, callback=lambda at, _: reached.append(at["info"]["is_success"]))
        count = sum(reached[49::50][-args.goals :])
        print(f"after {model.num_timesteps} steps: {count} of {args.goals} {goals} goals reached")
    save_policy(model, env, path := args.out / f"{args.env.lower()}.policy", summary={"steps": args.steps})
    print(f"{path}: try it on a simulated robot:\n  {deploy_command(path)}")


if __name__ == "__main__":
    main(tyro.cli(Args))
