"""Run a controller on a robot, using only the camera: the deployment loop with a simulated robot and a software D455.

Images pass through librealsense, are rectified and aligned, and the shape is found in them, as with a camera on USB.
The law is simple: each gripper moves and turns towards the goal's end. Replace it by your own controller, and
``shape_obs_envs.robots:SimulatedRobot`` by your arm.

Run: ``uv run examples/deploy_loop.py`` (needs the extras ``sim`` and ``realsense``)
"""

import gymnasium as gym
import numpy as np

from shape_obs import ShapeGoal, ShapeObservation, Target
from shape_obs.deploy import Limits, deploy
from shape_obs_envs.robots import SimulatedRobot


class EndsFirst:
    """Move the rope's ends to those of the goal, at most as far as the robot moves in a step."""

    gain = 0.15

    def bind(self, action_spec):
        """Store the scale of an action. The loop calls this at the start."""
        self.scale = np.reshape(action_spec.scale, (2, 3))  # x, y [m] and yaw [rad] of both grippers

    def act(self, observation):
        """Return an action, (6,) in -1 ... 1."""
        seen, goal = (observation[key].reshape(-1, 3) for key in ("achieved_goal", "desired_goal"))
        away = (goal - seen)[[0, -1], :2]
        turn = heading(goal) - heading(seen)
        move = np.column_stack([away, np.arctan2(np.sin(turn), np.cos(turn))])
        return np.clip(self.gain * move / self.scale, -1, 1).ravel()


def heading(points):
    """Return the headings of the rope at its first and last end, (2,) in radians."""
    x, y, _ = np.array([points[2] - points[0], points[-1] - points[-3]]).T
    return np.arctan2(y, x)


def main() -> None:
    robot = SimulatedRobot(seed=4, difficulty="near")
    robot.connect()
    robot.reset()
    goal = Target.read(robot.goal)  # on a real table: shape-obs goal -o goal.yaml, and Target.load("goal.yaml")
    robot.disconnect()  # the next connection starts from the same state

    env = gym.make("shape_obs_envs:ShapeObs/D455-v0", source="robot", robot=robot, rate=30)
    env = ShapeGoal(ShapeObservation(env), goal=goal, threshold=0.015)
    distances = []

    def look(moment):
        points = moment.frame.camera.to_base(moment.detection.shapes[0].points3d)
        distances.append(1e3 * np.linalg.norm(points - np.asarray(goal.points), axis=1).mean())

    report = deploy(env, EndsFirst(), Limits(hold=0.5), seconds=6, until_reached=5, on_step=look)
    print(report)
    print(f"from {distances[0]:.0f} to {distances[-1]:.0f} mm from the goal, {report.overruns} overruns")


if __name__ == "__main__":
    main()
