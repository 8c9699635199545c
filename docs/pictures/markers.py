"""The pictures of 'Markers and calibration': uv run python docs/pictures/markers.py."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from sheet import grid, titled

from shape_obs import HSVRange, Markers, Polygon, ShapeDetector, TopView
from shape_obs.calibration import Board
from shape_obs.cli.markers import describe_board
from shape_obs.drawing import draw_curve, draw_detection, draw_text
from shape_obs.markers import find_markers
from shape_obs.markers.sheet import PER_MM, board_page, marker_pages
from tests.benchmarks.scenes.tabletop import LAYOUT, MarkerScene, marker_scene

IMAGES = Path(__file__).parent.parent / "images"
SCENE = 22
INK, AREA, FOUND, LINES = (30, 30, 30), (30, 110, 220), (40, 160, 60), (255, 255, 255)
ROPE = np.stack([np.linspace(0.12, 0.48, 80), 0.21 + 0.07 * np.sin(np.linspace(0, 6, 80))], axis=1)
BLUE = HSVRange((100, 80, 40), (130, 255, 255))


def with_ropes(scene: MarkerScene) -> np.ndarray:
    """The scene with a rope between the markers and one outside."""
    picture = scene.rgb.copy()
    for rope in (ROPE, ROPE + (0.03, 0.36)):
        line = np.round(scene.to_pixels(rope) * 16).astype(np.int32)
        cv2.polylines(picture, [line], False, (20, 50, 170), 7, cv2.LINE_AA, 4)
    return picture


def looked_at(picture: np.ndarray) -> np.ndarray:
    """What is found between the markers, the area, and the markers that are seen."""
    region = Markers().place(picture, None).region
    assert isinstance(region, Polygon)
    detection = ShapeDetector([{"kind": "centerline", "n": 10}], BLUE, roi="markers").detect(picture)
    shown = draw_detection(picture, detection, size=1.6)
    area = np.array(region.points)
    draw_curve(shown, np.concatenate([area, area[:1]]), AREA, thickness=2)
    for number, corners in find_markers(picture).items():
        draw_curve(shown, np.concatenate([corners, corners[:1]]), FOUND, thickness=2)
        u, v = corners.max(axis=0)
        draw_text(shown, str(number), (round(u) + 4, round(v) + 4), INK, size=2.2)
    return shown


def under_a_hand(picture: np.ndarray, scene: MarkerScene) -> np.ndarray:
    """Something lies over marker 1."""
    picture = picture.copy()
    u, v = scene.to_pixels(LAYOUT.array[1].mean(axis=0))
    cv2.ellipse(picture, ((float(u) + 30, float(v) - 5), (120, 62), -25.0), (205, 160, 135), -1, cv2.LINE_AA)
    return picture


def from_above(picture: np.ndarray) -> np.ndarray:
    """The table from above, with a line every 10 cm."""
    per_metre, margin = 800, 0.06
    above = TopView.find(picture, LAYOUT).warp(picture, per_metre, margin)
    height, width = above.shape[:2]
    for tenth in range(7):
        at = (margin + tenth / 10) * per_metre - 0.5
        for line in (((at, 0), (at, height)), ((0, at), (width, at))):
            draw_curve(above, np.array(line, np.float64), LINES)
        draw_text(above, f"{tenth / 10:.1f} m", (round(at) + 3, 24), INK, size=1.7)
    return above


def tile(panel: np.ndarray, title: str, height: int = 384) -> np.ndarray:
    """A panel of a height under its title."""
    width = round(panel.shape[1] * height / panel.shape[0])
    small = cv2.resize(panel, (width, height), interpolation=cv2.INTER_AREA)
    return titled(small, title, 24)


def sheets() -> np.ndarray:
    """The two pages that can be printed."""
    pages = [marker_pages([0, 1, 2, 3], 60)[0], board_page(Board().picture(1000 * PER_MM), describe_board(Board()))]
    shown = []
    for page in pages:
        framed = np.pad(page, 6, constant_values=120)
        width = round(framed.shape[1] * 420 / framed.shape[0])
        small = cv2.resize(framed, (width, 420), interpolation=cv2.INTER_AREA)
        shown.append(np.pad(small, ((4, 4), (8, 8)), constant_values=255))
    return np.repeat(np.concatenate(shown, axis=1)[..., None], 3, axis=2)


def save(name: str, picture: np.ndarray) -> None:
    """Write it as a JPEG."""
    cv2.imwrite(str(IMAGES / name), picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])


if __name__ == "__main__":
    seen = marker_scene(SCENE)
    image = with_ropes(seen)
    tiles = [
        tile(looked_at(image), "The area between four markers"),
        tile(looked_at(under_a_hand(image, seen)), "One marker is hidden"),
        tile(from_above(image), "The table from above"),
    ]
    save("markers.jpg", grid(tiles, len(tiles), gap=6))
    save("marker_sheets.jpg", sheets())
