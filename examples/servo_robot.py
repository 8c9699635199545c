"""Servo a shape on a robot, using only the camera: the law of shape_servo.py with a software D455.

The simulated robot moves a rope in real time; images pass through librealsense, are rectified and aligned, and the
shape is found in them, as with a camera on USB. The law learns how the rope responds to the motions. It assumes that
the next image shows the effect of each motion: ten steps per second leave enough time for that, and a small gain
tolerates small delays.

Run: ``uv run --extra sim --extra realsense examples/servo_robot.py [SEED]``
"""

import sys

import gymnasium as gym
import numpy as np

from shape_obs import ShapeGoal, ShapeObservation, Target
from shape_obs.deploy import Limits, deploy
from shape_obs.servo import DampedLeastSquares, Excitation, PseudoJacobian, ShapeServo
from shape_obs_envs.robots import SimulatedRobot


def main() -> None:
    robot = SimulatedRobot(seed=int(sys.argv[1]) if len(sys.argv) > 1 else 5, difficulty="near")
    robot.connect()  # the first reset of the run restores the start of this goal
    goal = Target.read(robot.goal)  # on a real table: shape-obs goal -o goal.yaml, and Target.load("goal.yaml")

    env = gym.make("shape_obs_envs:ShapeObs/D455-v0", source="robot", robot=robot, rate=10)
    env = ShapeGoal(ShapeObservation(env), goal=goal, features=[{"kind": "points3d", "frame": "base"}], threshold=0.01)
    servo = ShapeServo(DampedLeastSquares(PseudoJacobian(), gain=0.3), excitation=Excitation(hold=1))
    distances = []

    def look(moment):
        points = moment.frame.camera.to_base(moment.detection.shapes[0].points3d)
        distances.append(1e3 * np.linalg.norm(points - np.asarray(goal.points), axis=1).mean())

    report = deploy(env, servo, Limits(hold=0.5), seconds=15, until_reached=5, on_step=look)
    print(report)
    print(f"from {distances[0]:.0f} to {distances[-1]:.0f} mm from the goal, {servo.law.learnt} motions learnt from")


if __name__ == "__main__":
    main()
