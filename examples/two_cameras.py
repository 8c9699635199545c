"""Use one detector for each of two cameras that see the same rope, because a detector stores the track of one camera.

Run: ``uv run examples/two_cameras.py``
"""

import cv2
import numpy as np

from shape_obs import Centerline, HSVRange, ShapeDetector

FRAMES, TABLE, BLUE = 30, (200, 198, 190), (20, 70, 160)
SIDES = np.array([[[1.0, 0.1], [-0.1, 0.9]], [[0.8, -0.3], [0.2, 1.1]]])  # each camera sees the table rotated


def drawn_views(t: float) -> list[np.ndarray]:
    """Return the image of each camera, (H, W, 3) uint8, with the rope at time t = 0...1."""
    s = np.linspace(-1, 1, 200)
    rope = np.stack([220 * s, 60 * np.sin(3 * s + 2 * t)], axis=1)
    views = [np.full((480, 640, 3), TABLE, np.uint8) for _ in SIDES]
    for view, side in zip(views, SIDES, strict=True):
        fixed = np.round(16 * (rope @ side.T + (320, 240))).astype(np.int32)
        cv2.polylines(view, [fixed], False, BLUE, 13, cv2.LINE_AA, 4)
    return views


def main() -> None:
    rule = HSVRange((100, 80, 40), (125, 255, 255))
    detectors = [ShapeDetector(Centerline(n=20), rule) for _ in SIDES]
    for frame in range(FRAMES):
        views = drawn_views(frame / FRAMES)
        for camera, (detector, view) in enumerate(zip(detectors, views, strict=True)):
            shape = detector.detect(view, stamp=frame / 30).shapes[0]
            if frame % 10 == 0:
                print(f"camera {camera}: ok: {shape.ok}, point 0 at {shape.pixels[0].round(1)}")


if __name__ == "__main__":
    main()
