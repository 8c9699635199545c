"""What a camera makes of a scene: light, colours, blur, sharpening, noise and compression."""

from __future__ import annotations

import cv2
import numpy as np
from curves import HEIGHT, SHAPE, WIDTH, Array, Random, direction, noise


def photograph(rng: Random, picture: Array) -> Array:
    """Return a photo ``(HEIGHT, WIDTH, 3)`` uint8 of a scene, RGB 0...255."""
    if rng.random() < 0.6:  # uneven light
        light = np.clip(noise(rng, SHAPE, rng.uniform(80, 250)), -2, 2)
        picture = picture * (1 + rng.uniform(0.05, 0.3) * light)[..., None]
    if rng.random() < 0.3:  # vignetting
        y, x = np.mgrid[-1 : 1 : HEIGHT * 1j, -1 : 1 : WIDTH * 1j].astype(np.float32)
        picture = picture * (1 - rng.uniform(0, 0.18) * (x * x + y * y))[..., None]
    exposure = rng.uniform(0.75, 1.25) if rng.random() < 0.8 else rng.uniform(0.4, 1.7)
    picture = picture * np.float32(rng.uniform(0.83, 1.17, 3) * exposure)  # and the white balance
    picture = 255 * np.power(np.clip(picture, 0, 255) / 255, rng.uniform(0.75, 1.35))
    if rng.random() < 0.25:  # low contrast: haze, glare
        picture = picture + (rng.uniform(60, 200) - picture) * rng.uniform(0.05, 0.35)
    picture = _blurred(rng, picture)
    if rng.random() < 0.3:
        picture = picture + (picture - cv2.GaussianBlur(picture, (0, 0), 1)) * rng.uniform(0.3, 1.6)
    picture = picture + rng.standard_normal(picture.shape, np.float32) * rng.exponential(3)
    if rng.random() < 0.2:  # noise of colours in spots of some pixels
        spots = rng.standard_normal((HEIGHT // 3, WIDTH // 3, 3), np.float32) * rng.exponential(4)
        picture = picture + cv2.resize(spots, (WIDTH, HEIGHT))
    photo = np.clip(picture, 0, 255).astype(np.uint8)
    if rng.random() < 0.5:
        encoded = cv2.imencode(".jpg", photo, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(30, 95))])[1]
        photo = np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR))
    return photo


def _blurred(rng: Random, picture: Array) -> Array:
    """Blur a picture by focus, by motion or by scaling down and up, or leave it sharp."""
    kind = rng.choice(["sharp", "focus", "motion", "scaling"], p=[0.35, 0.43, 0.08, 0.14])
    if kind == "focus":
        return cv2.GaussianBlur(picture, (0, 0), 0.3 + rng.exponential(0.45))
    if kind == "motion":  # along a line through the middle of a 9 x 9 kernel
        reach, kernel = rng.uniform(0.5, 4) * np.array(direction(rng)), np.zeros((9, 9), np.float32)
        cv2.line(kernel, (4 - reach).round().astype(int).tolist(), (4 + reach).round().astype(int).tolist(), 1.0)
        return cv2.filter2D(picture, -1, kernel / kernel.sum())
    if kind == "scaling":
        scale = rng.uniform(0.45, 0.9)
        return cv2.resize(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), (WIDTH, HEIGHT))
    return picture
