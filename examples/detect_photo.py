"""Find ordered points in a photo and draw them, without an env.

Run: ``uv run examples/detect_photo.py PHOTO u,v``, where u,v is a pixel on the rope. Without arguments it draws a rope.
"""

import sys
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from shape_obs import Centerline, ShapeDetector
from shape_obs.clicks import propose_segmentation
from shape_obs.drawing import draw_detection


def drawn_photo() -> np.ndarray:
    """Return an image of a blue rope on a light table."""
    s = np.linspace(0, 1, 200)
    rope = np.stack([80 + 480 * s, 240 + 120 * np.sin(7 * s) * s], axis=1)
    photo = np.full((480, 640, 3), (200, 198, 190), np.uint8)
    cv2.polylines(photo, [np.round(rope).astype(np.int32)], False, (20, 70, 160), 13, cv2.LINE_AA)
    return photo


def main() -> None:
    if len(sys.argv) == 3:
        photo = np.array(Image.open(sys.argv[1]).convert("RGB"))
        u, v = (float(part) for part in sys.argv[2].split(","))
    else:
        photo, u, v = drawn_photo(), 80.0, 240.0
    proposal = propose_segmentation(photo, [(u, v)])
    detector = ShapeDetector([Centerline(n=20, ends="tips")], proposal.rule)
    detection = detector.detect(photo)
    rope = detection["centerline"]
    print(proposal.text)
    print(f"ok: {rope.ok} {rope.reason}, quality {rope.quality:.2f}, in {detection.timings['total']:.1f} ms")
    print(rope.points2d.round(1))
    picture = Path("detect_photo.png")
    cv2.imwrite(str(picture), draw_detection(photo, detection)[..., ::-1])
    print("picture:", picture)


if __name__ == "__main__":
    main()
