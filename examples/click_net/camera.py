"""What a camera makes of a scene: light, colours, blur, sharpening, noise and compression."""

from __future__ import annotations

import cv2
import numpy as np
from curves import SHAPE, Array, Random, noise


def photograph(rng: Random, picture: Array) -> Array:
    """Return a photo ``(HEIGHT, WIDTH, 3)`` uint8 of a scene, RGB 0...255."""
    light = np.clip(noise(rng, SHAPE, rng.uniform(80, 250)), -2, 2)  # uneven, at times
    radius = np.hypot(*np.mgrid[-1 : 1 : SHAPE[0] * 1j, -1 : 1 : SHAPE[1] * 1j].astype(np.float32))
    vignette = max(0, rng.uniform(-0.4, 0.18)) * radius**2
    picture = picture * ((1 + max(0, rng.uniform(-0.2, 0.3)) * light) * (1 - vignette))[..., None]
    exposure = rng.uniform(0.75, 1.25) if rng.random() < 0.8 else rng.uniform(0.4, 1.7)
    picture = picture * np.float32(rng.uniform(0.83, 1.17, 3) * exposure)  # and the white balance
    picture = 255 * np.power(np.clip(picture, 0, 255) / 255, rng.uniform(0.75, 1.35))
    picture = picture + (rng.uniform(60, 200) - picture) * max(0, rng.uniform(-1, 0.35))  # haze, glare
    blur = rng.choice(["none", "focus", "motion"], p=[0.35, 0.57, 0.08])
    if blur == "focus":
        picture = cv2.GaussianBlur(picture, (0, 0), 0.3 + rng.exponential(0.45))
    elif blur == "motion":  # along x or y
        picture = cv2.blur(picture, (1, int(rng.integers(2, 8)))[:: rng.choice([-1, 1])])
    picture = picture + (picture - cv2.GaussianBlur(picture, (0, 0), 1)) * max(0, rng.uniform(-3.2, 1.6))  # sharpened
    picture = picture + rng.standard_normal(picture.shape, np.float32) * rng.exponential(3)
    if rng.random() < 0.2:  # noise of colours in spots of some pixels
        spots = rng.standard_normal((SHAPE[0] // 3, SHAPE[1] // 3, 3), np.float32) * rng.exponential(4)
        picture = picture + cv2.resize(spots, SHAPE[::-1])
    photo = np.clip(picture, 0, 255).astype(np.uint8)
    if rng.random() < 0.5:
        quality = cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(30, 95))
        return np.asarray(cv2.imdecode(cv2.imencode(".jpg", photo, quality)[1], cv2.IMREAD_COLOR))
    return photo
