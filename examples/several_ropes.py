"""Find every rope of one colour in an image, where they lie over each other, and whether one of them is knotted.

Run: ``uv run examples/several_ropes.py FOLDER``; the picture goes to that folder, by default ``overlays``.
"""

import sys
from pathlib import Path

import cv2
import numpy as np

from shape_obs import Centerline, HSVRange, ShapeDetector
from shape_obs.drawing import draw_detection
from shape_obs.geometry.crossings import format_code, gauss_code
from shape_obs.geometry.knots import is_knotted

TABLE, BLUE, EDGE, HALF_WIDTH = (200, 198, 190), (60, 110, 210), (20, 45, 110), 5.0


def knotted() -> np.ndarray:
    """Return the axis (P, 3) of a rope with an overhand knot: u, v and height."""
    t = np.linspace(1.13 * np.pi, 2.87 * np.pi, 900)
    u, v = np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t)
    return np.stack([170 + 42 * u, 230 - 42 * v, -np.sin(3 * t)], axis=1)


def looped() -> np.ndarray:
    """Return the axis of a rope with a loop that rises all the way: no knot."""
    s = np.linspace(-1, 1, 900)
    turn = 2 * np.pi / (1 + np.exp(-9 * s))
    steps = 0.85 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return np.column_stack([np.cumsum(steps, axis=0) + (215, 120), s])


def straight() -> np.ndarray:
    """Return the axis of a rope that lies under the others."""
    s = np.linspace(0, 1, 900)
    return np.stack([310 + 210 * s, 430 - 370 * s + 25 * np.sin(5 * s), np.full(900, -2.0)], axis=1)


def drawn_photo() -> np.ndarray:
    """Return an image (H, W, 3) of the ropes: short pieces with dark edges, the lowest first."""
    photo, pieces = np.full((480, 640, 3), TABLE, np.uint8), []
    for rope in (knotted(), looped(), straight()):
        along = np.gradient(rope[:, :2], axis=0)
        normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
        sides = [np.round(16 * (rope[:, :2] + sign * HALF_WIDTH * normal)).astype(np.int32) for sign in (1, -1)]
        starts = range(0, len(rope) - 1, 6)
        pieces += [(rope[k, 2], *(side[k : k + 8] for side in sides)) for k in starts]
    for _, left, right in sorted(pieces, key=lambda piece: piece[0]):
        cv2.fillPoly(photo, [np.concatenate([left, right[::-1]])], BLUE, cv2.LINE_AA, 4)
        cv2.polylines(photo, [left, right], False, EDGE, 2, cv2.LINE_AA, 4)
    return photo


def main() -> None:
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "overlays")
    photo = drawn_photo()
    detector = ShapeDetector(
        [Centerline(name="rope", n=30, count="all", ends="tips")], HSVRange((100, 100, 60), (125, 255, 255))
    )
    detection = detector.detect(photo)
    print(f"{len(detection)} ropes in {detection.timings['total']:.1f} ms")
    for crossing in detection.crossings:
        first, second = (f"{name} at {arc:.2f}" for name, arc in zip(crossing.slots, crossing.arcs, strict=True))
        level = "?" if crossing.above is None else ("above", "below")[crossing.above]
        print(f"  {crossing.pixel[0]:3.0f}, {crossing.pixel[1]:3.0f}: {first} {level} {second}")
    for rope in detection:
        knot = {True: "knotted", False: "not knotted", None: "unknown"}[is_knotted(detection.crossings, rope.name)]
        print(f"{rope.name}: ok: {rope.ok} {rope.reason}, {knot}; {format_code(gauss_code(rope.crossings, rope.name))}")
    folder.mkdir(parents=True, exist_ok=True)
    picture = folder / "several_ropes.png"
    cv2.imwrite(str(picture), draw_detection(photo, detection, scale=2)[..., ::-1])
    print("picture:", picture)


if __name__ == "__main__":
    main()
