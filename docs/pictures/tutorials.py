"""The pictures at the ends of the tutorials: uv run python docs/pictures/tutorials.py [FOLDER/cable.policy].

Each is what the code of its page draws. Those of the pages on training and deployment are drawn if a policy is given,
as ``examples/train_sac_her.py --out FOLDER --seed 1`` saves it.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image
from stages import write

from shape_obs import ShapeDetector
from shape_obs.drawing import draw_detection
from shape_obs_envs.robots import SimulatedRobot

DOCS = Path(__file__).parents[1]
DRAWN = {
    "start/five-minutes.md": "five_minutes.jpg",
    "tutorials/first-vector.md": "first_vector.jpg",
    "tutorials/wrap-your-env.md": "wrap_your_env.jpg",
    "tutorials/several-ropes.md": "three_slots.jpg",
}
TRAINED = {
    "tutorials/train.md": ("policy.png", "train.jpg"),
    "tutorials/deploy-on-a-simulated-robot.md": ("deployed.png", "deployed.jpg"),
}
PYTHON = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SWAY = np.array([0.004, 0.006, 0.03, -0.004, 0.002, 0.04])  # of both grippers: x, y [m] and yaw [rad]


def run(page: str, names: dict[str, object], policy: str = "") -> None:
    """Run the Python blocks of a page in one namespace, with the given policy."""
    for code in PYTHON.findall((DOCS / page).read_text(encoding="utf-8")):
        exec(code.replace("runs/cable/cable.policy", policy), names)


def recorded() -> np.ndarray:
    """Return two images of a software D455 with the points that were found, next to each other."""
    robot = SimulatedRobot(seed=1)
    defaults = robot.shape_obs_defaults
    detector = ShapeDetector(defaults["shapes"], defaults["segmentation"])
    robot.connect()
    robot.reset()
    panels = []
    try:
        with robot.source() as source:
            for step in range(13):
                robot.send(SWAY, until=time.monotonic() + 0.2)
                frame = source.read(timeout=5)
                detection = detector.detect(frame.rgb, frame.depth, frame.camera, anchors=robot.anchors)
                if step in (0, 12):
                    panels.append(draw_detection(frame.rgb, detection)[:400])
    finally:
        robot.disconnect()
    return np.hstack(panels)


def main() -> None:
    policy = str(Path(sys.argv[1]).resolve()) if len(sys.argv) > 1 else ""
    os.chdir(tempfile.mkdtemp())
    for page, name in DRAWN.items():
        names: dict[str, object] = {"__name__": "tutorial"}
        run(page, names)
        write(name, np.asarray(names["picture"]))
    write("real_camera.jpg", recorded())
    if policy:
        for page, (drawn, name) in TRAINED.items():
            run(page, {"__name__": "__main__"}, policy)
            write(name, np.asarray(Image.open(drawn)))


if __name__ == "__main__":
    main()
