"""The picture of clicks: uv run python docs/pictures/clicks.py."""

from __future__ import annotations

import sys
from itertools import count
from pathlib import Path

import cv2
import numpy as np
from sheet import Key, grid, legend, save
from stages import IMAGES

from shape_obs import Centerline, Contour, ShapeDetector
from shape_obs.clicks import propose_segmentation
from shape_obs.drawing import VALID, draw_detection

sys.path.insert(0, str(Path(__file__).parents[2]))
from tests.benchmarks.clicks import first_click, is_right
from tests.benchmarks.scenes.object_photos import THIN, Kind, object_photo

LETTERS = 40  # pixels of a picture of 1936
CLICK, MASK = (255, 0, 200), (0, 150, 255)
# The kind of object and the ground of each photo.
PHOTOS: tuple[tuple[Kind, str], ...] = (
    ("rope", "mat"),
    ("wire", "wood"),
    ("sheet", "concrete"),
    ("garment", "carpet"),
    ("ring", "floor"),
    ("wire", "pegboard"),
)


def panel(kind: Kind, ground: str) -> np.ndarray:
    """The first photo where one click is enough and all is in sight, the mask that it gives, and the points on it."""
    for seed in count():
        photo = object_photo(np.random.default_rng(seed), kind, ground)
        u, v = first_click(np.random.default_rng(0), photo)
        proposal = propose_segmentation(photo.rgb, [(u, v)])
        shape = Centerline(n=20) if kind in THIN else Contour(n=24)
        detection = ShapeDetector([shape], proposal.rule).detect(photo.rgb)
        pieces = 1 if kind in THIN else cv2.connectedComponents(proposal.mask.view(np.uint8))[0] - 1
        if is_right(proposal.mask, photo) and detection.ok and detection.shapes[0].visible.all() and pieces == 1:
            break
    tinted = photo.rgb.copy()
    tinted[proposal.mask] = (0.5 * tinted[proposal.mask] + 0.5 * np.array(MASK)).astype(np.uint8)
    picture = draw_detection(tinted, detection, size=1.4)
    cv2.drawMarker(picture, (round(u), round(v)), (255, 255, 255), cv2.MARKER_CROSS, 44, 10)
    cv2.drawMarker(picture, (round(u), round(v)), CLICK, cv2.MARKER_CROSS, 40, 5)
    return picture


def main() -> None:
    """Draw the picture."""
    panels = [panel(kind, ground) for kind, ground in PHOTOS]
    keys = [Key("one click", CLICK, "patch"), Key("what it selects", MASK, "patch"), Key("ordered points", VALID)]
    drawn = grid(panels, 3)
    drawn = np.concatenate([drawn, legend(keys, drawn.shape[1], LETTERS)])
    size = 1400, round(len(drawn) * 1400 / drawn.shape[1])
    save(IMAGES / "clicks.jpg", np.asarray(cv2.resize(drawn, size, interpolation=cv2.INTER_AREA)))


if __name__ == "__main__":
    main()
