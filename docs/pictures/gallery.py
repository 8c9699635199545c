"""The small pictures of the page 'Examples': uv run python docs/pictures/gallery.py [NAME ...].

Some are parts of pictures of other pages; the others are what the examples draw or find.
"""

from __future__ import annotations

import importlib
import os
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import gymnasium as gym
import numpy as np
from sheet import grid
from stages import IMAGES

from shape_obs import HSVRange, ShapeDetector, ShapeGoal, ShapeObservation
from shape_obs.drawing import GOAL, draw_curve, draw_detection
from shape_obs.servo import ShapeServo
from shape_obs.training import Pixels
from shape_obs_envs.d455 import D455Noise

sys.path.insert(0, str(Path(__file__).parents[2] / "examples"))  # some have the name of a script here

SIZE = (400, 250)
PAPER = 255
CABLE = "shape_obs_envs:ShapeObs/Cable-v0"


def part(name: str, left: float = 0, top: float = 0, right: float = 1, bottom: float = 1) -> np.ndarray:
    """Return a part of a picture of the docs; the sides are shares of its width and height."""
    picture = cv2.imread(str(IMAGES / name))[..., ::-1]
    height, width = picture.shape[:2]
    return picture[round(top * height) : round(bottom * height), round(left * width) : round(right * width)]


def written(example: str, picture: str) -> np.ndarray:
    """Run an example, and return a picture that it writes."""
    sys.argv = [example]
    importlib.import_module(example).main()
    return cv2.imread(picture)[..., ::-1]


def plot(name: str, panel: int, panels: int = 4) -> np.ndarray:
    """Return one panel of a row of plots, whole, on white."""
    picture = part(name, panel / panels, 0, (panel + 1) / panels)
    height, width = picture.shape[:2]
    wide = max(width, round(height * SIZE[0] / SIZE[1]))
    left = (wide - width) // 2
    return cv2.copyMakeBorder(picture, 0, 0, left, wide - width - left, cv2.BORDER_CONSTANT, value=(PAPER,) * 3)


def drawn(env: Any, observation: dict[str, Any], scale: int = 1) -> np.ndarray:
    """Return the image of a wrapped env with its points, over the goal in orange."""
    goal = env.unwrapped.camera_model.project_from_base(observation["desired_goal"].reshape(-1, 3))
    return draw_detection(env.render(), env.detection, scale=scale, under=[(goal, GOAL)])


def cable(**options: Any) -> ShapeObservation:
    return ShapeObservation(gym.make(CABLE, camera="d455", render_mode="rgb_array", **options))


def point_cloud() -> np.ndarray:
    from point_cloud import START, made_up_cloud

    from shape_obs import Centerline

    cloud = made_up_cloud()
    rope = ShapeDetector([Centerline(n=20, ends="tips", anchor=START)]).detect_cloud(cloud)["centerline"]
    picture = np.full((500, 800, 3), 250, np.uint8)

    def seen(points: np.ndarray) -> np.ndarray:
        """Look at the points at a slant from above."""
        x, y, z = points.T
        return np.stack([400 + 1200 * x, 420 - 1200 * (0.8 * y + 0.6 * (z - START[2]))], axis=1)

    for point in seen(cloud).round().astype(int):
        cv2.circle(picture, point.tolist(), 1, (120, 140, 190), -1)
    assert rope.points3d is not None
    for k, point in enumerate(seen(rope.points3d).round().astype(int)):
        cv2.circle(picture, point.tolist(), 9, (255, 255, 255), -1, cv2.LINE_AA)
        cv2.circle(picture, point.tolist(), 7, (45, 185, 85) if k else (20, 20, 20), -1, cv2.LINE_AA)
    return picture


def two_cameras() -> np.ndarray:
    from two_cameras import drawn_views

    from shape_obs import Centerline

    rule = HSVRange((100, 80, 40), (125, 255, 255))
    views = [
        draw_detection(view, ShapeDetector(Centerline(n=20), rule).detect(view))[:, 120:520] for view in drawn_views(0)
    ]
    return grid(views, columns=2)


def own_clusterer() -> np.ndarray:
    from own_clusterer import BLUE, Quantiles, photo

    from shape_obs import Centerline

    image, _ = photo()
    return draw_detection(image, ShapeDetector([Centerline(n=12)], BLUE, clustering=Quantiles(trim=0.2)).detect(image))


def own_feature() -> np.ndarray:
    env = cable()
    env.reset(seed=0)
    assert env.detection is not None
    points = env.detection.shapes[0].pixels
    picture = env.render()
    draw_curve(picture, points[[0, -1]].astype(np.float64), (210, 40, 160), thickness=3)
    far = np.argmin(points[:, 1])
    foot = points[0] + (points[-1] - points[0]) * (points[far, 0] - points[0, 0]) / (points[-1, 0] - points[0, 0])
    draw_curve(picture, np.stack([points[far], foot]).astype(np.float64), (210, 40, 160), thickness=3)
    return draw_detection(picture, env.detection)


def demonstration(steps: tuple[int, ...], **options: Any) -> list[np.ndarray]:
    """Play the motion that leads to a goal, and return the images at some steps."""
    env = cable(**options)
    observation, _ = env.reset(seed=3)
    actions = list(env.unwrapped.goal_actions)  # type: ignore[attr-defined]
    panels = []
    for step in range(max(steps) + 1):
        if step in steps:
            panels.append(drawn(env, observation))
        observation, *_ = env.step(actions[step] if step < len(actions) else 0 * actions[0])
    return panels


def shape_servo() -> np.ndarray:
    env = gym.make("shape_obs_envs:ShapeObs/Ring-v0", camera="d455", render_mode="rgb_array", max_episode_steps=500)
    env = ShapeGoal(
        ShapeObservation(D455Noise(env)),
        features=[{"kind": "elliptic_fourier", "harmonics": 6, "frame": "base"}],
        threshold=0.01,
    )
    servo = ShapeServo("rls")
    servo.attach(env)
    observation, _ = env.reset(seed=1)
    for _ in range(12):
        observation, *_ = env.step(servo.act(observation))
    goal = env.targets[0].points2d  # type: ignore[attr-defined]
    under = [(np.vstack([goal, goal[:1]]), GOAL)]
    return draw_detection(env.render(), env.get_wrapper_attr("detection"), under=under)


def on_robot(example: str, at: int) -> np.ndarray:
    """Run an example on the simulated robot, and return what its camera sees at a step."""
    module = importlib.import_module(example)
    panels: list[np.ndarray] = []
    deploy = module.deploy

    def watched(env: Any, *arguments: Any, on_step: Any, **options: Any) -> Any:
        def look(moment: Any) -> None:
            on_step(moment)
            if moment.step == at:
                under = [(target.points2d, GOAL) for target in env.targets]
                panels.append(draw_detection(moment.frame.rgb, moment.detection, under=under))

        return deploy(env, *arguments, on_step=look, **options)

    module.deploy = watched
    sys.argv = [example]
    module.main()
    return panels[0][20:405, 10:626]


def starts(seeds: tuple[int, ...]) -> list[np.ndarray]:
    """Return starts of the trainings whose goal is one shape, with that goal."""
    env = cable()
    env.reset(seed=0)
    panels = []
    goal = None
    for seed in seeds:
        observation, _ = env.reset(seed=seed)
        goal = observation["desired_goal"] if goal is None else goal
        panels.append(drawn(env, {"desired_goal": goal})[20:420])
    return panels


def pixels() -> np.ndarray:
    env = Pixels(gym.make(CABLE, camera=[84, 84]))
    observation, _ = env.reset(seed=0)
    image = next(value for value in observation.values() if value.ndim == 3)
    return cv2.resize(image[..., :3], (672, 672), interpolation=cv2.INTER_NEAREST)[60:480]


def hanging() -> np.ndarray:
    env = gym.make("shape_obs_envs:ShapeObs/Hanging-v0", camera="d455", render_mode="rgb_array")
    env = ShapeObservation(env)
    observation, _ = env.reset(seed=2)
    return drawn(env, observation)[40:440]


def small() -> np.ndarray:
    env = ShapeObservation(gym.make(CABLE, camera=[84, 84], render_mode="rgb_array"))
    observation, _ = env.reset(seed=0)
    return drawn(env, observation, scale=8)[60:480]


PICTURES: dict[str, Callable[[], np.ndarray]] = {
    "first_vector": partial(part, "first_vector.jpg", 0, 0, 1, 0.84),
    "wrap_your_env": partial(part, "wrap_your_env.jpg"),
    "foreign_env": partial(part, "foreign_envs.jpg", 0.5, 0, 1, 0.5),
    "foreign_env_depth": partial(part, "foreign_envs.jpg", 0, 0, 0.5, 0.5),
    "detect_photo": lambda: written("detect_photo", "detect_photo.png"),
    "three_shapes": lambda: written("three_shapes", "overlays/three_shapes.png"),
    "several_ropes": lambda: written("several_ropes", "overlays/several_ropes.png"),
    "markers": lambda: written("markers", "overlays/markers_9.png"),
    "point_cloud": point_cloud,
    "two_cameras": two_cameras,
    "own_feature": own_feature,
    "own_clusterer": own_clusterer,
    "features_offline": partial(part, "features.jpg", 0.33, 0, 0.66, 1),
    "lerobot_dataset": lambda: grid([panel[:425, 150:490] for panel in demonstration((0, 20))], columns=2),
    "log_rerun": partial(part, "rerun.jpg"),
    "shape_goal": lambda: demonstration((10,))[0][:400],
    "shape_servo": shape_servo,
    "servo_robot": lambda: on_robot("servo_robot", 8),
    "deploy_loop": lambda: on_robot("deploy_loop", 4),
    "deploy_policy": partial(part, "deployed.jpg", 0.345, 0.06, 0.66, 1),
    "train_sac_her": partial(part, "train.jpg", 1 / 3, 0, 2 / 3, 1),
    "train_sac": lambda: starts((5, 6))[1],
    "train_ppo": lambda: grid(starts((5, 6, 7, 8)), columns=2, gap=0),
    "train_cnn": pixels,
    "study_cable": partial(plot, "ablate_curves.png", 0, 1),
    "study_curves": partial(plot, "train_curves.png", 0),
    "study_image": partial(plot, "train_image.png", 0),
    "study_cables": partial(plot, "train_cables.png", 0),
    "study_hanging": hanging,
    "study_smoke": small,
}


def thumbnail(picture: np.ndarray) -> np.ndarray:
    """Return the middle of a picture in the size of the gallery."""
    height, width = picture.shape[:2]
    scale = max(SIZE[0] / width, SIZE[1] / height)
    size = max(SIZE[0], round(scale * width)), max(SIZE[1], round(scale * height))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    left, top = (size[0] - SIZE[0]) // 2, (size[1] - SIZE[1]) // 2
    return small[top : top + SIZE[1], left : left + SIZE[0]]


def main() -> None:
    names = sys.argv[1:] or list(PICTURES)
    os.chdir(tempfile.mkdtemp())
    for name in names:
        picture = np.ascontiguousarray(thumbnail(PICTURES[name]())[..., ::-1])
        path = IMAGES / f"gallery_{name}.jpg"
        cv2.imwrite(str(path), picture, [cv2.IMWRITE_JPEG_QUALITY, 85])
        print(path.name, f"{path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
