"""The picture of 'Features': uv run python docs/pictures/features.py."""

from __future__ import annotations

import cv2
import gymnasium as gym
import numpy as np
from sheet import write_text
from stages import write

from shape_obs import Shape, ShapeObservation
from shape_obs.features import FeatureContext, read_features
from shape_obs.geometry.topology import Chain, Ring

MAGENTA, GREEN, GRAY = (205, 40, 150), (20, 120, 60), (120, 120, 120)
ZOOM, FINE = 2, 400
WIDTH, HEIGHT, HEADING = 560, 520, 130  # of a panel, and of the part of it that is kept for words


def main() -> None:
    cable, ring = seen("Cable", 5), seen("Ring", 9)
    panels = [
        picture(*cable, "fourier", "harmonics", (2, 4)),
        picture(*cable, "bspline", "coefficients", (5, 8)),
        picture(*ring, "elliptic_fourier", "harmonics", (2, 4)),
    ]
    write("features.jpg", np.concatenate(panels, axis=1))


def seen(name: str, seed: int) -> tuple[np.ndarray, Shape, FeatureContext]:
    """An image of a shape that its demonstration has bent, what was found in it, and what surrounds it."""
    env = gym.make(f"shape_obs_envs:ShapeObs/{name}-v0", camera=(640, 480), difficulty="far", render_mode="rgb_array")
    observing = ShapeObservation(env)
    observing.reset(seed=seed)
    for action in env.unwrapped.goal_actions:  # type: ignore[attr-defined]
        observing.step(action)
    image = np.asarray(env.render())
    assert observing.detection is not None
    found = image, observing.detection.shapes[0], observing.contexts[0]
    observing.close()
    return found


def picture(
    image: np.ndarray, shape: Shape, view: FeatureContext, kind: str, setting: str, values: tuple[int, int]
) -> np.ndarray:
    """The points, and the curves of a feature with few functions and with more of them."""
    out = cv2.resize(255 - (0.45 * (255.0 - image)).astype(np.uint8), None, fx=ZOOM, fy=ZOOM)
    fine = Ring(FINE) if isinstance(shape.layout, Ring) else Chain(FINE)
    notes: list[tuple[str, tuple[int, int, int]]] = []
    for value, colour in zip(values, (MAGENTA, GREEN), strict=True):
        (feature,) = read_features([{"kind": kind, setting: value, "frame": "pixels"}])
        coefficients = feature.compute(shape, view)
        curve = placed(feature.reconstruct(coefficients, fine, view))
        cv2.polylines(out, [curve], isinstance(fine, Ring), colour, 3, cv2.LINE_AA, 4)
        notes.append((f"{setting} = {value}: {len(coefficients)} values", colour))
        if kind == "bspline" and value == values[-1]:
            control = placed(coefficients.reshape(-1, 2))
            cv2.polylines(out, [control], False, GRAY, 1, cv2.LINE_AA, 4)
            for point in control:
                cv2.circle(out, tuple(map(int, point)), 16 * 5, GRAY, 2, cv2.LINE_AA, 4)
    for point in placed(shape.pixels):
        cv2.circle(out, tuple(map(int, point)), 16 * 4, (20, 20, 20), -1, cv2.LINE_AA, 4)
    left, top = (ZOOM * (shape.pixels.min(axis=0) + shape.pixels.max(axis=0)) / 2).astype(int) - (
        WIDTH // 2,
        (HEIGHT + HEADING) // 2,
    )
    out = np.pad(out, ((HEIGHT, HEIGHT), (WIDTH, WIDTH), (0, 0)), mode="edge")
    out = out[top + HEIGHT : top + 2 * HEIGHT + HEADING, left + WIDTH : left + 2 * WIDTH].copy()
    notes.insert(0, (kind, (20, 20, 20)))
    for line, (text, colour) in enumerate(notes):
        out = write_text(out, text, (12, 24 + 31 * line), 25, colour=colour, bold=line == 0)
    return out


def placed(points: np.ndarray) -> np.ndarray:
    """Pixels of the enlarged image, in sixteenths."""
    return np.round(16 * (ZOOM * (points + 0.5) - 0.5)).astype(np.int32)


if __name__ == "__main__":
    main()
