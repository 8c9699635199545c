"""Use four ArUco markers on a table as the region of interest, and to convert pixels to metres without depth.

A rope lies between the markers, and another one of the same colour outside. The camera looks at the table at a slant,
and is pushed after ten frames.

Run: ``uv run examples/markers.py FOLDER``; the pictures go to that folder, by default ``overlays``.
"""

import sys
from pathlib import Path

import cv2
import numpy as np

from shape_obs import Centerline, HSVRange, MarkerLayout, ShapeDetector, TopView
from shape_obs.drawing import draw_detection

# 60 mm markers in the corners of 600 x 420 mm, measured from outer edge to outer edge.
LAYOUT = MarkerLayout.rectangle(marker=0.06, width=0.60, height=0.42)
PER_METRE, MARGIN = 1500, 0.2  # pixels and metres, of the drawn table
BLUE = HSVRange(low=(100, 80, 40), high=(125, 255, 255))


def rope() -> np.ndarray:
    """Return the axis of the rope, (P, 2) in metres on the table."""
    s = np.linspace(0, 1, 200)
    return np.stack([0.13 + 0.34 * s, 0.21 + 0.08 * np.sin(5 * s)], axis=1)


def to_drawing(points: np.ndarray) -> np.ndarray:
    """Convert metres on the table to pixels of the drawn table."""
    return (points + MARGIN) * PER_METRE - 0.5


def drawn_table() -> np.ndarray:
    """Return an image of the table from above, (h, w, 3)."""
    width, height = ((np.array(LAYOUT.box[1]) + 2 * MARGIN) * PER_METRE).astype(int)
    table = np.full((height, width, 3), (200, 198, 190), np.uint8)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    for number, corners in zip(LAYOUT.ids, to_drawing(LAYOUT.array), strict=True):
        left, top = np.round(corners[0] + 0.5).astype(int)
        side = round(0.06 * PER_METRE)
        table[top - 15 : top + side + 15, left - 15 : left + side + 15] = 245
        table[top : top + side, left : left + side] = cv2.aruco.generateImageMarker(dictionary, number, side)[..., None]
    for points in (rope(), rope() + (0, 0.34)):
        cv2.polylines(table, [np.round(to_drawing(points)).astype(np.int32)], False, (20, 70, 160), 20, cv2.LINE_AA)
    return table


def camera_image(aside: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the camera's image (480, 640, 3), and the homography from metres on the table to its pixels."""
    seen = np.array([(120, 90), (500, 70), (570, 370), (70, 350)], np.float32) + np.array((aside, 0), np.float32)
    corners = np.array([LAYOUT.array[i, i] for i in range(4)], np.float32)
    homography = cv2.getPerspectiveTransform(corners, seen)
    scale = np.array([[1 / PER_METRE, 0, -MARGIN], [0, 1 / PER_METRE, -MARGIN], [0, 0, 1]])
    fine = np.diag([2.0, 2.0, 1.0]) @ homography @ scale
    image = cv2.warpPerspective(drawn_table(), fine, (1280, 960), borderValue=(150, 150, 150))
    return cv2.resize(image, (640, 480), interpolation=cv2.INTER_AREA), homography


def main() -> None:
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "overlays")
    folder.mkdir(parents=True, exist_ok=True)
    detector = ShapeDetector([Centerline(n=20)], BLUE, roi={"kind": "markers", "every": 5})
    for frame in range(20):
        image, _ = camera_image(aside=0 if frame < 10 else 45)
        detection = detector.detect(image)
        if frame in (9, 19):
            shape = detection.shapes[0]
            view = TopView.find(image, LAYOUT)
            points = view.to_table(shape.points2d)
            off = np.linalg.norm(points[:, None] - rope(), axis=2).min(axis=1)
            above = view.warp(image, pixels_per_metre=1000, margin=0.05)
            print(f"frame {frame}: ok: {shape.ok}, markers {view.seen}, {1000 * off.max():.1f} mm off the rope at most")
            cv2.imwrite(str(folder / f"markers_{frame}.png"), draw_detection(image, detection)[..., ::-1])
            cv2.imwrite(str(folder / f"markers_{frame}_above.png"), above[..., ::-1])
    print("pictures:", folder)


if __name__ == "__main__":
    main()
