"""Two cameras look at one rope, each with its own detector and track, in threads of one process.

Run: ``uv run examples/two_cameras.py``
"""

import cv2
import numpy as np

from shape_obs import Centerline, DetectorPool, HSVRange, ShapeDetector

FRAMES, TABLE, BLUE = 30, (200, 198, 190), (20, 70, 160)
SIDES = np.array([[[1.0, 0.1], [-0.1, 0.9]], [[0.8, -0.3], [0.2, 1.1]]])  # each camera sees the table turned


def drawn_views(t: float) -> list[np.ndarray]:
    """The rope at t = 0...1 as each camera sees it: (H,W,3) uint8."""
    s = np.linspace(-1, 1, 200)
    rope = np.stack([220 * s, 60 * np.sin(3 * s + 2 * t)], axis=1)
    views = [np.full((480, 640, 3), TABLE, np.uint8) for _ in SIDES]
    for view, side in zip(views, SIDES, strict=True):
        fixed = np.round(16 * (rope @ side.T + (320, 240))).astype(np.int32)
        cv2.polylines(view, [fixed], False, BLUE, 13, cv2.LINE_AA, 4)
    return views


def main() -> None:
    rule = HSVRange((100, 80, 40), (125, 255, 255))
    with DetectorPool([ShapeDetector(Centerline(n=20), rule) for _ in SIDES]) as pool:
        for frame in range(FRAMES):
            detections = pool.detect(drawn_views(frame / FRAMES), stamps=frame / 30)
            if frame % 10 == 0:
                for camera, detection in enumerate(detections):
                    shape = detection.shapes[0]
                    print(f"camera {camera}: ok: {shape.ok}, point 0 at {shape.pixels[0].round(1)}")


if __name__ == "__main__":
    main()
