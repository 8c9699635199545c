"""Light a pile of objects as a room does, and photograph it with a camera of one sensor: mosaic, noise, JPEG file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np

from shape_obs.bench.scenes import SIZE
from tests.benchmarks.scenes.height_field import SQUARE, Array, Field, Image, axes, unit
from tests.benchmarks.scenes.laid_objects import Pile

_MARCH: Final = (1.0, 2.5, 4.5, 7.0, 11.0, 17.0, 26.0, 40.0)  # pixels towards the light at which shadows are looked for
_SENSOR: Final = np.array([0.55, 1.0, 0.65], np.float32)  # how much of white light red, green and blue pixels see


@dataclass(frozen=True)
class Shadow:
    """The shadow of something outside the photo."""

    outline: Array  # (P, 2) pixels
    soft: float  # width of its border, pixels
    strength: float  # share of the light that is missing in it


@dataclass(frozen=True)
class Light:
    """A lamp or a window, and the light that comes from all sides."""

    toward: Array  # (3,) unit vector: right, down, up
    ambient: float  # share of the light that comes from all sides
    fall: Array  # (2,) change of the light to the right and down, in e-folds of the photo's width
    soft: float  # how blurred shadows of objects are, pixels
    shadows: tuple[Shadow, ...] = ()
    level: float = 1.0

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Light:
        """Draw a light."""
        toward = unit(np.array([*rng.normal(0, 0.5, 2), rng.uniform(0.6, 1.2)]))
        fall = rng.normal(0, 0.5 if rng.random() < 0.3 else 0.15, 2)
        light = cls(toward, float(rng.uniform(0.3, 0.65)), fall, float(rng.uniform(0.8, 4)))
        count = int(rng.choice([0, 1, 2], p=[0.6, 0.3, 0.1]))
        return replace(light, shadows=tuple(light.new_shadow(rng) for _ in range(count)))

    def new_shadow(self, rng: np.random.Generator) -> Shadow:
        """Draw the shadow of a person, an arm, a shelf or a window frame."""
        centre, turn = rng.uniform((0, 0), SIZE[::-1]), rng.uniform(0, np.pi)
        half = rng.uniform(30, 260), 900.0
        corners = SQUARE * half * rng.uniform(0.7, 1.2, (4, 2)) @ axes(turn) + centre
        return Shadow(corners, float(np.exp(rng.uniform(np.log(3), np.log(40)))), float(rng.uniform(0.2, 0.6)))

    def on(self, pile: Pile) -> Field:
        """Return the light that each pixel of a photo sends to the camera: ``(H, W, 3)`` linear, before exposure."""
        size = SIZE[::-1]
        height = cv2.resize(pile.height, size, interpolation=cv2.INTER_AREA)
        flat, hidden = self.toward[:2] / max(float(np.linalg.norm(self.toward[:2])), 1e-6), np.zeros(SIZE, np.float32)
        steep = float(self.toward[2] / max(float(np.linalg.norm(self.toward[:2])), 0.15))
        for far in _MARCH:
            shift = np.array([[1, 0, -far * flat[0]], [0, 1, -far * flat[1]]])
            there = cv2.warpAffine(height, shift, size, borderMode=cv2.BORDER_REPLICATE)
            hidden = np.maximum(hidden, np.clip((there - height - far * steep) / 2, 0, 1))
        key = (1 - self.ambient) * (1 - cv2.GaussianBlur(hidden, (0, 0), self.soft))
        for shadow in self.shadows:
            layer = np.zeros(SIZE, np.float32)
            cv2.fillPoly(layer, [np.round(np.clip(shadow.outline, -4000, 4000)).astype(np.int32)], (shadow.strength,))
            key *= 1 - cv2.GaussianBlur(layer[::2, ::2], (0, 0), shadow.soft / 2).repeat(2, 0).repeat(2, 1)
        corner = np.clip((cv2.GaussianBlur(height, (0, 0), 5) - height) / 12, 0, 0.6)
        v, u = np.mgrid[: SIZE[0], : SIZE[1]].astype(np.float32) / SIZE[1] - 0.4
        fall = np.exp(np.float32(self.fall[0]) * u + np.float32(self.fall[1]) * v) * np.float32(self.level)
        fine = pile.size[::-1]
        key, around = (cv2.resize(part, fine) for part in (key * fall, self.ambient * (1 - corner) * fall))
        right, down = pile.slope[..., 0], pile.slope[..., 1]
        up = np.sqrt(np.clip(1 - right**2 - down**2, 0, 1))
        x, y, z = (np.float32(part) for part in self.toward)
        facing = (right * x + down * y) / z + up
        shine = (right * x + down * y + up * (z + 1)) * np.float32(1 / np.linalg.norm(self.toward + (0, 0, 1)))
        for _ in range(5):
            shine *= shine  # to the power 32
        bright = 1.5 * pile.gloss * shine
        lit = key * np.clip(facing, 0, 2) + around * (0.45 + 0.55 * up)
        picture = pile.albedo * lit[..., None] + (bright * key)[..., None]
        return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.float32)


class Camera:
    """A camera that has set its exposure and its white balance for a ground, not quite right."""

    def __init__(self, rng: np.random.Generator, ground: Field) -> None:
        gray = float(ground[::8, ::8].mean())
        self.exposure = float(0.36 / gray**0.65 * np.exp(rng.normal(0, 0.25)))
        self.tint = np.exp(rng.normal(0, (0.08, 0.02, 0.1))).astype(np.float32)  # error of the white balance
        self.blur = float(rng.uniform(0.35, 1.0))  # pixels
        self.spread = float(rng.uniform(0, 0.0015))  # share by which red is larger than blue: chromatic aberration
        self.dim = float(rng.uniform(0, 0.35))  # how much less light the corners get
        self.noise = float(np.exp(rng.uniform(np.log(0.003), np.log(0.02))))  # deviation of a gray pixel, linear
        self.contrast = float(rng.uniform(0, 0.6))
        self.colourful = float(rng.uniform(0.65, 1.15))
        self.sharpened = float(rng.choice([0, 0.5, 1.0]))
        self.quality = int(rng.integers(60, 97))  # of the JPEG file

    def take(self, rng: np.random.Generator, light: Field) -> Image:
        """Return the photo of what sends light, ``(H, W, 3)`` uint8."""
        height, width = SIZE
        v, u = np.mgrid[:height, :width].astype(np.float32)
        away = ((u / width - 0.5) ** 2 + (v / width - 0.375) ** 2) * 4
        seen = cv2.GaussianBlur(light, (0, 0), self.blur) * (self.exposure * (1 - self.dim * away))[..., None]
        seen = seen * (self.tint * _SENSOR)
        for k, sign in ((0, 1), (2, -1)):
            scale = 1 + sign * self.spread
            zoom = np.array([[scale, 0, (1 - scale) * width / 2], [0, scale, (1 - scale) * height / 2]])
            seen[..., k] = cv2.warpAffine(seen[..., k], zoom, (width, height), borderMode=cv2.BORDER_REPLICATE)
        raw = seen[..., 1].copy()  # red, green / green, blue
        raw[::2, ::2], raw[1::2, 1::2] = seen[::2, ::2, 0], seen[1::2, 1::2, 2]
        raw += self.noise * np.sqrt(0.1 + np.clip(raw, 0, 2)) * rng.standard_normal(SIZE, np.float32)
        counts = np.clip(raw * 60000, 0, 65535).astype(np.uint16)
        rgb = cv2.cvtColor(counts, cv2.COLOR_BayerRGGB2RGB).astype(np.float32) / 60000 / _SENSOR
        rgb = np.clip(rgb, 0, 1) ** np.float32(1 / 2.2)
        rgb += self.contrast * rgb * (1 - rgb) * (rgb - 0.45)
        smooth = cv2.cvtColor(np.clip(rgb, 0, 1), cv2.COLOR_RGB2YCrCb)
        smooth[..., 1:] = 0.5 + (cv2.GaussianBlur(smooth[..., 1:], (0, 0), 1.2) - 0.5) * self.colourful
        smooth[..., 0] += self.sharpened * (smooth[..., 0] - cv2.GaussianBlur(smooth[..., 0], (0, 0), 1.2))
        picture = np.clip(np.round(255 * cv2.cvtColor(smooth, cv2.COLOR_YCrCb2BGR)), 0, 255).astype(np.uint8)
        packed = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, self.quality])[1]
        return np.ascontiguousarray(np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR), np.uint8)[..., ::-1])
