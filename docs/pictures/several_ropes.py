"""The pictures of 'Several ropes of one colour': uv run python docs/pictures/several_ropes.py."""

from __future__ import annotations

import cv2
import numpy as np
from stages import INK, PAPER, write

from shape_obs import Centerline, Detection, ShapeDetector
from shape_obs.drawing import draw_curve, draw_detection, draw_text, slot_colours
from tests.benchmarks.scenes.moving_ropes import moving_ropes
from tests.benchmarks.scenes.several_ropes import several_ropes

N = 20
FEW = 10  # points of the tracked ropes
SEED, FRAMES = 0, (0, 45, 75, 120)
CLOSE = (slice(480, 960), slice(500, 1140))  # of a picture twice as large


def stages() -> np.ndarray:
    """Draw a scene, its slots, and its crossings."""
    scene = several_ropes(np.random.default_rng([1, 44]), 4, 7, (480, 640), 10.0)
    detector = ShapeDetector([Centerline(n=N, name="rope", count="all", ends="tips")])
    detection = detector.detect_mask(scene.mask, rgb=scene.rgb)
    slots = scene.rgb.copy()
    for shape in detection:
        draw_curve(slots, shape.pixels.astype(np.float64), slot_colours(detection)[shape.name], thickness=4)
        u, v = shape.pixels[N // 2].tolist()
        draw_text(slots, shape.name, (min(round(u) + 12, 570), round(v) - 8), size=1.6)
    panels = {
        "1  one colour, one mask": scene.rgb,
        f"2  {len(detection)} slots": slots,
        f"3  {N} points each, {len(detection.crossings)} crossings": draw_detection(scene.rgb, detection, size=1.4),
        "4  the upper strand is drawn over the lower one": draw_detection(scene.rgb, detection, scale=2, size=1.6)[
            CLOSE
        ],
    }
    return tiled([titled(panel, title) for title, panel in panels.items()])


def tracked() -> np.ndarray:
    """Draw frames of a sequence in which ropes are moved across each other."""
    detector = ShapeDetector([Centerline(n=FEW, name="rope", count=3, ends="tips")])
    panels = []
    for frame, moment in enumerate(moving_ropes(np.random.default_rng(SEED), pictures=True)):
        detection: Detection = detector.detect_mask(moment.mask)
        if frame in FRAMES and moment.rgb is not None:
            panels.append(titled(draw_detection(moment.rgb, detection, size=1.6), f"frame {frame}"))
    return tiled(panels)


def tiled(panels: list[np.ndarray]) -> np.ndarray:
    """Return four pictures in two rows."""
    return np.vstack([np.hstack(panels[:2]), np.hstack(panels[2:])])


def titled(picture: np.ndarray, title: str) -> np.ndarray:
    """Return a picture with a border and a line of text above it."""
    framed = cv2.copyMakeBorder(picture, 34, 6, 6, 6, cv2.BORDER_CONSTANT, value=PAPER)
    cv2.putText(framed, title, (10, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.7, INK, 1, cv2.LINE_AA)
    return framed


if __name__ == "__main__":
    for name, picture in (("several_ropes.jpg", stages()), ("several_ropes_tracked.jpg", tracked())):
        write(name, picture)
