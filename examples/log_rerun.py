"""Log a loop of your own to the rerun viewer: image, mask, points, features, timings and reasons.

The images are drawn here; put your camera in their place. Without a window, it writes a file to open later.

Run: ``uv run --extra rerun examples/log_rerun.py [--window]``
"""

import sys

import cv2
import numpy as np
import rerun

from shape_obs import CameraModel, Centerline, HSVRange, Intrinsics, ShapeDetector, log_rerun
from shape_obs.features import FeatureContext, FeatureVector, read_features

CAMERA = Intrinsics(width=640, height=480, fx=600.0, fy=600.0, cx=319.5, cy=239.5)
BLUE = HSVRange(low=(100, 120, 40), high=(125, 255, 255))
FRAMES, LOST = 60, range(30, 36)


def read_camera(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Return an image of a swaying rope and its depth in millimetres; for some frames the rope is gone."""
    rgb, depth = np.full((480, 640, 3), (200, 198, 190), np.uint8), np.full((480, 640), 800, np.uint16)
    if number not in LOST:
        s = np.linspace(0, 1, 200)
        rope = np.stack([80 + 480 * s, 240 + 120 * np.sin(7 * s) * s + 40 * np.sin(0.1 * number)], axis=1)
        line = np.round(rope).astype(np.int32)
        cv2.polylines(rgb, [line], False, (20, 70, 160), 13, cv2.LINE_AA)
        cv2.polylines(depth, [line], False, 785, 13)
    return rgb, depth


def main() -> None:
    rerun.init("my_robot", spawn="--window" in sys.argv)  # pyright: ignore[reportAttributeAccessIssue]
    if "--window" not in sys.argv:
        rerun.save("my_robot.rrd")  # pyright: ignore[reportAttributeAccessIssue]
    detector = ShapeDetector([Centerline(n=20, name="rope", ends="tips")], BLUE)
    context = FeatureContext(640, 480, CameraModel(CAMERA))
    features = FeatureVector(read_features(["length", "centroid"]), detector.shapes, context)
    found = 0
    for number in range(FRAMES):
        rgb, depth = read_camera(number)
        detection = detector.detect(rgb, depth, CAMERA, stamp=number / 30)
        found += detection["rope"].reason == ""
        values = features.named(features.compute(detection.shapes, [context]))
        log_rerun(detection, rgb, depth, CAMERA, features=values)
    print(f"found in {found} of {FRAMES} frames")
    if "--window" not in sys.argv:
        print("open it with: rerun my_robot.rrd")


if __name__ == "__main__":
    main()
