"""Compare Gymnasium's Swimmer with its simulator's truth as JSON, in a separate process for OpenGL.

Run by test_foreign_envs.py; on Linux without a display with MUJOCO_GL=egl.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "examples"))

import foreign_env_depth  # pyright: ignore[reportMissingImports]

# Bodies, and places on their x axes: the nose, the joints, the tail. Rounded tips included.
CHAIN = (("torso", 1.6), ("torso", 0.5), ("mid", -1.0), ("back", -1.1))


def main() -> None:
    env = foreign_env_depth.make_env()
    camera = env.get_wrapper_attr("camera_model")
    pixels, metres, ok = [], [], []
    env.reset(seed=0)
    for step in range(30):
        *_, info = env.step(foreign_env_depth.stroke(step))
        assert env.detection is not None
        shape, data = env.detection.shapes[0], env.get_wrapper_attr("data")
        chain = np.array([data.body(name).xpos + x * data.body(name).xmat.reshape(3, 3)[:, 0] for name, x in CHAIN])
        arc = np.append(0, np.cumsum(np.linalg.norm(np.diff(chain, axis=0), axis=1)))
        at = np.linspace(0, arc[-1], len(shape.pixels))
        truth = np.stack([np.interp(at, arc, axis) for axis in chain.T], axis=1)
        ok.append(info["shape/ok"] and bool(shape.valid.all()))
        pixels.append(np.linalg.norm(shape.pixels - camera.project_from_base(truth), axis=1))
        metres.append(np.linalg.norm(camera.to_base(shape.points3d) - truth, axis=1))
    env.close()
    measured = {"ok": all(ok), "pixels": np.mean(pixels), "metres": np.mean(metres), "worst_metres": np.max(metres)}
    print(json.dumps(measured, default=float))


if __name__ == "__main__":
    main()
