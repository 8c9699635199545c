"""Use goals in features: bring a simulated cable into a shape, and score it by the camera's points.

The example plays the environment's own demonstration, records the final shape as a goal, and scores the same motion
against it.

Run: ``uv run --extra sim examples/shape_goal.py``
"""

import json

import gymnasium as gym

from shape_obs import ShapeGoal, ShapeObservation, Target


def play(env: ShapeGoal, seed: int) -> None:
    """Play the demonstration of a seed, and print the distance from the goal."""
    observation, info = env.reset(seed=seed)
    print(f"start: {1e3 * info['goal/distance']:.0f} mm from the goal, is_success: {info['is_success']}")
    actions = env.unwrapped.goal_actions  # type: ignore[attr-defined]
    for step, action in enumerate(actions, start=1):
        observation, reward, _, _, info = env.step(action)
        if step % 8 == 0:
            print(f"  step {step:2d}: {1e3 * info['goal/distance']:5.1f} mm, reward {reward:.4f}")
    rest = 0 * actions[0]
    for _ in range(10):  # the cable settles
        observation, reward, _, _, info = env.step(rest)
    print(f"end: is_success: {info['is_success']}, the simulator says {info['truth/is_success']}")
    relabelled = env.compute_reward(observation["achieved_goal"], observation["achieved_goal"], {})
    assert relabelled == 0  # as in hindsight replay: the achieved goal replaces the desired one


def main() -> None:
    source = ShapeObservation(
        gym.make("shape_obs_envs:ShapeObs/Cable-v0"),
        features=[{"kind": "points3d", "frame": "base"}, "ok", "valid"],
    )
    env = ShapeGoal(source, threshold=0.01)
    print("goals:", env.observation_space["desired_goal"].shape, "distances in", env.unit)  # type: ignore[index]
    play(env, seed=0)

    goal = env.record_goal()
    text = json.dumps(goal.to_dict())
    print(f"recorded: {goal.layout}, {len(goal.points)} points in frame {goal.frame!r}, {len(text)} characters of JSON")
    play(ShapeGoal(source, goal=Target.from_dict(json.loads(text)), threshold=0.005), seed=0)
    env.close()


if __name__ == "__main__":
    main()
