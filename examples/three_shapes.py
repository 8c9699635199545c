"""Find a rope, an elastic band and a cloth in one image: three configurations with their own colours in one detector.

The cloth turns by 60 degrees in 20 frames, and each point stays on its place of the cloth.

Run: ``uv run examples/three_shapes.py FOLDER``; the picture goes to that folder, by default ``overlays``.
"""

import sys
from pathlib import Path

import cv2
import numpy as np

from shape_obs import Centerline, Contour, Detection, HSVRange, ShapeDetector, Surface
from shape_obs.drawing import draw_detection

FRAMES = 20
TABLE, BLUE, ORANGE, GREEN = (200, 198, 190), (20, 70, 160), (225, 120, 40), (60, 150, 80)


def rope(t: float) -> np.ndarray:
    """Return the axis (P, 2) of a rope whose right end swings."""
    s = np.linspace(0, 1, 200)
    return np.stack([40 + 260 * s, 120 + 50 * np.sin(6 * s) + 40 * t * s**2], axis=1)


def band(t: float) -> np.ndarray:
    """Return the axis (P, 2) of an elastic band that turns by 40 degrees."""
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    radius = 70 + 12 * np.cos(2 * angle) + 8 * np.cos(3 * angle)
    at = angle + np.radians(40) * t
    return np.stack([480 + 1.2 * radius * np.cos(at), 130 + radius * np.sin(at)], axis=1)


def cloth(t: float) -> np.ndarray:
    """Return the corners (4, 2) of a cloth that turns by 60 degrees."""
    corners = np.array([[-110.0, -60], [110, -60], [110, 60], [-110, 60]])
    cos, sin = np.cos(np.radians(60) * t), np.sin(np.radians(60) * t)
    return corners @ np.array([[cos, sin], [-sin, cos]]) + (320, 340)


def drawn_scene(t: float) -> np.ndarray:
    """Return the image (H, W, 3) of the scene at t = 0...1."""
    scene = np.full((480, 640, 3), TABLE, np.uint8)
    cv2.polylines(scene, [fixed(rope(t))], False, BLUE, 11, cv2.LINE_AA, 4)
    cv2.polylines(scene, [fixed(band(t))], True, ORANGE, 13, cv2.LINE_AA, 4)
    cv2.fillPoly(scene, [fixed(cloth(t))], GREEN, cv2.LINE_AA, 4)
    return scene


def fixed(points: np.ndarray) -> np.ndarray:
    """Convert pixels to OpenCV's fixed-point numbers, in sixteenths."""
    return np.round(16 * points).astype(np.int32)


def tell(detection: Detection, t: float) -> None:
    print(f"t = {t:.1f}, in {detection.timings['total']:.1f} ms")
    for shape in detection:
        print(f"  {shape.name}: {shape.layout}, ok: {shape.ok} {shape.reason}, quality {shape.quality:.2f}")
    off = np.linalg.norm(detection["cloth"].pixels[[0, 7, 31, 24]] - cloth(t), axis=1)
    print(f"  points 0, 7, 31, 24 of the cloth lie {off.max():.1f} px off its corners at most")


def main() -> None:
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "overlays")
    detector = ShapeDetector(
        [
            Centerline(name="rope", n=20, ends="tips", segmentation=HSVRange((100, 80, 40), (125, 255, 255))),
            Contour(name="band", n=32, segmentation=HSVRange((5, 120, 60), (20, 255, 255))),
            Surface(name="cloth", rows=4, cols=8, ends="tips", segmentation=HSVRange((50, 80, 40), (80, 255, 255))),
        ]
    )
    tell(detector.detect(drawn_scene(0.0)), 0.0)
    for frame in range(1, FRAMES):
        detector.detect(drawn_scene(frame / FRAMES))
    scene = drawn_scene(1.0)
    detection = detector.detect(scene)
    tell(detection, 1.0)
    folder.mkdir(parents=True, exist_ok=True)
    picture = folder / "three_shapes.png"
    cv2.imwrite(str(picture), draw_detection(scene, detection)[..., ::-1])
    print("picture:", picture)


if __name__ == "__main__":
    main()
