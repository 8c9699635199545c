"""Observe the simulated cable as 60 numbers: 20 points along its axis, in metres, in the robot's base frame.

Run: ``uv run --extra sim examples/first_vector.py``
"""

import gymnasium as gym

from shape_obs import ShapeObservation


def main() -> None:
    env = ShapeObservation(gym.make("shape_obs_envs:ShapeObs/Cable-v0"))
    observation, info = env.reset(seed=0)
    print("observation:", observation["observation"].shape)
    for _ in range(10):
        observation, _, _, _, info = env.step(env.action_space.sample())
    points = observation["observation"].reshape(20, 3)
    print("held by gripper 0:", points[0].round(3), "  held by gripper 1:", points[-1].round(3))
    assert env.detection is not None
    print(f"found: {info['shape/ok']}, in {env.detection.timings['total']:.1f} ms")
    env.close()


if __name__ == "__main__":
    main()
