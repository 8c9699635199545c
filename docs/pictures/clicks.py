"""The picture of clicks: uv run python docs/pictures/clicks.py."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
from sheet import Key, grid, legend, save
from stages import IMAGES

from shape_obs import Centerline, Contour, ShapeDetector
from shape_obs.clicks import propose_segmentation
from shape_obs.drawing import VALID, draw_detection

sys.path.insert(0, str(Path(__file__).parents[2]))
from tests.benchmarks.clicks import first_click
from tests.benchmarks.scenes.object_photos import THIN, ObjectPhoto, object_photo

LETTERS = 40  # pixels of a picture of 1936
CLICK, MASK = (255, 0, 200), (255, 220, 0)
# Seed, kind, ground: what each photo shows.
PHOTOS = (
    (1, "rope", "mat"),
    (5, "wire", "wood"),
    (3, "sheet", "concrete"),
    (2, "garment", "carpet"),
    (6, "ring", "floor"),
    (4, "wire", "pegboard"),
)


def panel(photo: ObjectPhoto) -> np.ndarray:
    """A photo with one click, the mask that it gives, and the points of the detector."""
    u, v = first_click(np.random.default_rng(0), photo)
    proposal = propose_segmentation(photo.rgb, [(u, v)])
    shape = Centerline(n=20) if photo.kind in THIN else Contour(n=24)
    detection = ShapeDetector([shape], proposal.rule).detect(photo.rgb)
    tinted = photo.rgb.copy()
    tinted[proposal.mask] = (0.55 * tinted[proposal.mask] + 0.45 * np.array(MASK)).astype(np.uint8)
    picture = draw_detection(tinted, detection, size=1.4)
    cv2.drawMarker(picture, (round(u), round(v)), (255, 255, 255), cv2.MARKER_CROSS, 44, 10)
    cv2.drawMarker(picture, (round(u), round(v)), CLICK, cv2.MARKER_CROSS, 40, 5)
    return picture


def main() -> None:
    """Draw the picture."""
    panels = [panel(object_photo(np.random.default_rng(seed), kind, ground)) for seed, kind, ground in PHOTOS]
    keys = [Key("one click", CLICK, "patch"), Key("what it selects", MASK, "patch"), Key("ordered points", VALID)]
    drawn = grid(panels, 3)
    drawn = np.concatenate([drawn, legend(keys, drawn.shape[1], LETTERS)])
    size = 1400, round(len(drawn) * 1400 / drawn.shape[1])
    save(IMAGES / "clicks.jpg", np.asarray(cv2.resize(drawn, size, interpolation=cv2.INTER_AREA)))


if __name__ == "__main__":
    main()
