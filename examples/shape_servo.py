"""Servo shapes using only the camera: bring a cable, a ring, a cloth and a hanging rope into the shapes of their goals.

The law has no model of the objects, the robot or the camera's pose: it moves each coordinate of the robot a little,
learns how the shape responds, and continues to learn on the way. The images are those of a simulated D455, with its
noise and its holes. The simulator's points are only used to measure the distance from the goal.

Run: ``uv run --extra sim examples/shape_servo.py``
"""

import argparse

import gymnasium as gym

from shape_obs import ShapeGoal, ShapeObservation
from shape_obs.servo import ShapeServo
from shape_obs_envs.d455 import D455Noise

FEATURES = {
    "Cable": {"kind": "bspline", "coefficients": 8, "frame": "base"},
    "Ring": {"kind": "elliptic_fourier", "harmonics": 6, "frame": "base"},
    "Cloth": {"kind": "points3d", "frame": "base"},
    "Hanging": {"kind": "bspline", "coefficients": 8, "frame": "base"},
}


def make(name: str, difficulty: str) -> ShapeGoal:
    """Return an env whose goals are features of the camera's points."""
    env = gym.make(
        f"shape_obs_envs:ShapeObs/{name}-v0", camera=(160, 120), difficulty=difficulty, max_episode_steps=1000
    )
    return ShapeGoal(ShapeObservation(D455Noise(env)), features=[FEATURES[name]], threshold=0.01)


def bring(env: ShapeGoal, law: str, seed: int, most: int) -> bool:
    """Bring the shape to the goal of a seed, print the result, and return whether it came within 10 mm."""
    servo = ShapeServo(law)
    servo.attach(env)
    observation, info = env.reset(seed=seed)
    start, step = info["truth/mean_error"], 0
    while step < most and (servo.exciting or info["truth/mean_error"] > 0.005):
        observation, _, _, _, info = env.step(servo.act(observation))
        step += 1
    print(f"{1e3 * start:.1f} -> {1e3 * info['truth/mean_error']:.1f} mm in {step} steps")
    return info["truth/mean_error"] < 0.01


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--law", default="rls", help="broyden, rls, kalman, mfac or mfac-law")
    parser.add_argument("--difficulty", default="near", choices=["near", "middle", "far"])
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--steps", type=int, default=300, help="at most")
    arguments = parser.parse_args()
    reached = 0
    for name, feature in FEATURES.items():
        env = make(name, arguments.difficulty)
        print(f"{name:7s} {feature['kind']:16s}", end=" ")
        reached += bring(env, arguments.law, arguments.seed, arguments.steps)
        env.close()
    print(f"{reached} of {len(FEATURES)} goals within 10 mm")


if __name__ == "__main__":
    main()
