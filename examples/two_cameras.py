"""Two cameras look at one rope, each with its own detector and track, in threads of one process.

Run: ``uv run examples/two_cameras.py``
"""

import time

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
        cv2.polylines(view, [np.int32(16 * (rope @ side.T + (320, 240)))], False, BLUE, 13, cv2.LINE_AA, 4)
    return views


def main() -> None:
    rule = HSVRange((100, 80, 40), (125, 255, 255))
    with DetectorPool([ShapeDetector(Centerline(n=20), rule) for _ in SIDES]) as pool:
        spent = []
        for frame in range(FRAMES):
            views = drawn_views(frame / FRAMES)
            begin = time.perf_counter()
            detections = pool.detect(views, stamps=frame / 30)
            spent.append(time.perf_counter() - begin)
    for camera, detection in enumerate(detections):
        shape = detection.shapes[0]
        print(f"camera {camera}: ok: {shape.ok}, point 0 at {shape.pixels[0].round(1)}")
    print(f"both in {1e3 * np.median(spent):.1f} ms")


if __name__ == "__main__":
    main()
