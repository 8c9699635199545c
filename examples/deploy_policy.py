"""Bring a policy from training to a robot: save it, load it, and let it act on a camera's images.

The policy here is untrained: train it longer (``train_sac_her.py``), or run your own:
``shape-obs deploy cable.policy --source robot --robot shape_obs_envs.robots:SimulatedRobot --goal robot --episodes 20``

Run: ``uv run examples/deploy_policy.py`` (needs the extras ``sim``, ``sb3`` and ``realsense``)
"""

import gymnasium as gym
from stable_baselines3 import SAC, HerReplayBuffer

from shape_obs import ShapeObservation, Target, load_policy, save_policy
from shape_obs.deploy import deploy
from shape_obs.training import GoalDifference
from shape_obs_envs.robots import SimulatedRobot


def main() -> None:
    env = ShapeObservation(gym.make("shape_obs_envs:ShapeObs/Cable-v0", camera=[84, 84], reward_type="sparse"))
    network = {"features_extractor_class": GoalDifference, "net_arch": [64, 64]}
    replay = {"replay_buffer_class": HerReplayBuffer, "buffer_size": 1000}
    model = SAC("MultiInputPolicy", env, policy_kwargs=network, device="cpu", **replay)
    save_policy(model, env, "cable.policy", summary={"trained": "not at all"})

    policy = load_policy("cable.policy")
    print("reads", *(feature.kind for feature in policy.spec.features), "every", policy.spec.dt, "s")
    robot = SimulatedRobot(seed=4, difficulty="near")
    robot.connect()
    robot.reset()
    goal = Target.read(robot.goal)
    robot.disconnect()  # the next connection starts from the same state

    cell = gym.make(
        "shape_obs_envs:ShapeObs/D455-v0",
        source="robot",
        robot=robot,
        rate=1 / policy.spec.dt,
        settle=0.05,  # as in the simulator, take the image when the motion is over
    )
    print(deploy(policy.wrap(cell, goal), policy, steps=10))


if __name__ == "__main__":
    main()
