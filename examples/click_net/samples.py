"""Samples from scenes: which object is meant, the clicks, what the network sees, and what it should answer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import count, islice
from typing import Final

import cv2
import numpy as np
import torch
from curves import HEIGHT, SHAPE, WIDTH, Array, Random
from scene import Scene, draw_scene
from torch import Tensor
from torch.utils.data import Dataset

from shape_obs.image.click_net import Clicks, as_lab, network_input

_POOL, _NEW, _BATCH = 300, 4, 8  # scenes that a batch is drawn from, those of them that are new, and its samples
_LIKE: Final = {"click": 9.0, "video": 0.0, "colour": 14.0}  # CIE Lab; colours that are closer count as the same
_NEAR: Final = np.ones((5, 5), np.uint8)  # objects that come closer than 2 pixels touch


@dataclass
class Sample:
    """What the network sees and what it should answer."""

    photo: Array  # (h, w, 3) uint8, RGB
    target: Array  # (h, w) uint8: 1 the object, 0 not, 2 of no account
    on: Clicks  # on the object
    off: Clicks  # off it
    previous: Array | None  # (h, w), 0...1, the pass or frame before; None in the first pass
    kind: str  # "click", "video", "colour" or "ground", see ``draw_sample``
    thin: bool  # a rope or ring, not a sheet

    def seen(self) -> Array:
        """Return the input of the network, ``(11, h, w)``."""
        return network_input(self.photo, as_lab(self.photo), self.on, self.off, self.previous)

    def corrected(self, rng: Random, probability: Array) -> Sample:
        """Return the sample of the next pass, with a click on the largest error if there is one."""
        missed = _largest((self.target == 1) & (probability <= 0.5))
        extra = _largest((self.target == 0) & (probability > 0.5))
        name, error = ("on", missed) if missed.sum() > extra.sum() else ("off", extra)
        clicks: Clicks = getattr(self, name)
        if error.any():
            more = Clicks.at(as_lab(self.photo), _inside(rng, error)[None])
            clicks = Clicks(*map(np.concatenate, zip(clicks, more, strict=True)))
        return replace(self, previous=probability, **{name: clicks})


@lru_cache(_POOL)
def _scene(seed: int, number: int) -> Scene:
    return draw_scene(np.random.default_rng([seed, 0, number]))


@dataclass
class Batches(Dataset[tuple[list[Sample], Tensor]]):
    """Batches by their number: samples, and what the network sees of them ``(B, 11, h, w)`` float16."""

    seed: int  # that and the number say which batch it is: a training that is resumed sees what an unbroken one does

    def __getitem__(self, number: int) -> tuple[list[Sample], Tensor]:
        rng, drawn = np.random.default_rng([self.seed, 1, number]), (number + 1) * _NEW
        pool = range(max(0, drawn - _POOL), drawn)
        attempts = (draw_sample(rng, _varied(rng, _scene(self.seed, rng.choice(pool)))) for _ in count())
        samples = list(islice((sample for sample in attempts if sample), _BATCH))
        for k, sample in enumerate(samples):
            if sample.kind == "video" and rng.random() < 0.08:  # the object is not to be seen any more
                elsewhere = _scene(self.seed, rng.choice(pool)).photo
                samples[k] = replace(sample, photo=elsewhere, target=np.zeros(SHAPE, np.uint8))
        return samples, torch.from_numpy(np.stack([sample.seen() for sample in samples]).astype(np.float16))


def _varied(rng: Random, scene: Scene) -> Scene:
    """Mirror a scene, swap its colour channels and change its light."""
    x, y = rng.choice([-1, 1], 2)
    photo, whole, top = (np.ascontiguousarray(each[::y, ::x]) for each in (scene.photo, scene.whole, scene.top))
    photo = np.ascontiguousarray(photo[..., rng.permutation(3)]) if rng.random() < 0.5 else photo
    photo = _relit(rng, photo, offset=rng.uniform(-15, 15)) if rng.random() < 0.5 else photo
    return Scene(photo, whole, top, scene.kinds)


def _relit(rng: Random, photo: Array, offset: float = 0.0) -> Array:
    """Return a photo in a light that differs by up to a quarter."""
    gain = (rng.uniform(0.75, 1.25) * (1 + rng.normal(0, 0.02, 3))).astype(np.float32)
    return np.clip(photo * gain + offset, 0, 255).astype(np.uint8)


def draw_sample(rng: Random, scene: Scene, kind: str | None = None) -> Sample | None:
    """Draw a sample from a scene, by default of any kind, or None if nothing in it can be clicked.

    "click": clicks on the object and off it; "video": the mask of the frame before, places along the object, colours
    from before a change of light; "colour": such colours alone, of all objects that have them; "ground": of none.
    """
    kind = kind or str(rng.choice(["click", "video", "colour", "ground"], p=[0.63, 0.29, 0.05, 0.03]))
    if kind == "ground":
        return _on_ground(rng, scene)
    choices = [index for index in range(len(scene.kinds)) if (scene.top == index + 1).sum() > 60]  # pixels
    if not choices:
        return None
    index, lab = int(rng.choice(choices)), as_lab(scene.photo)
    mask = scene.whole >> index & 1
    seen = mask * (scene.top == index + 1).astype(np.uint8)
    off = _places_off(rng, scene, mask) if kind == "click" or (kind == "video" and rng.random() < 0.3) else []
    target, own = mask.copy(), lab[scene.top == index + 1].mean(0)
    for other, its_kind in enumerate(scene.kinds):
        part, visible = scene.whole >> other & 1, scene.top == other + 1
        alike = visible.any() and np.square(lab[visible].mean(0) - own) @ [0.5, 1, 1] < _LIKE[kind] ** 2
        # In a video the frame before shows which one is meant. Ropes are separated afterwards, by following one.
        either = not any(part[y, x] for x, y in off)
        ropes = scene.kinds[index] == its_kind == "rope"
        if alike and kind == "colour":
            target[part > 0] = 1
        elif alike and either and (ropes or cv2.dilate(part, _NEAR)[mask > 0].any()):
            target[(part > 0) & (mask == 0)] = 2
    crossing = seen * (scene.whole & (scene.whole - np.uint8(1)) > 0)  # more than one bit
    pixels = [_inside(rng, crossing if rng.random() < 0.2 and crossing.any() else seen)]
    pixels += [_inside(rng, seen) for _ in range(rng.integers(1, 3))] if rng.random() < 0.3 else []
    previous = _expected(rng, mask, scene.kinds[index]) if kind == "video" else None
    if kind == "click":
        pixels[0] += rng.integers(-2, 3, 2) if rng.random() < 0.25 else 0  # not quite hit
        on = Clicks.at(lab, np.array(pixels))
    else:
        places = np.zeros((0, 2), np.float32) if previous is None else _predicted(rng, previous)
        on = Clicks(places, Clicks.at(as_lab(_relit(rng, scene.photo)), np.array(pixels)).colours)
    return Sample(scene.photo, target, on, Clicks.at(lab, np.array(off)), previous, kind, scene.kinds[index] != "sheet")


def _on_ground(rng: Random, scene: Scene) -> Sample | None:
    """Draw a click on what is no object and no clutter: even, wide, and cut by the border of the photo."""
    away = 1 - cv2.dilate((scene.whole > 0).astype(np.uint8), np.ones((25, 25), np.uint8))
    if not away.any():
        return None
    pixel, even, step = _inside(rng, away), np.zeros((HEIGHT + 2, WIDTH + 2), np.uint8), (8, 8, 8)  # levels
    cv2.floodFill(scene.photo.copy(), even, pixel.tolist(), (0,), step, step, 4 | (1 << 8) | cv2.FLOODFILL_MASK_ONLY)
    even = even[1:-1, 1:-1]
    wide = min(even.mean(), np.concatenate([*even[[0, -1]], *even.T[[0, -1]]]).mean()) >= 0.2  # of photo and border
    on = Clicks.at(as_lab(scene.photo), pixel[None])
    return Sample(scene.photo, np.zeros(SHAPE, np.uint8), on, Clicks(), None, "ground", False) if wide else None


def _places_off(rng: Random, scene: Scene, mask: Array) -> list[Array]:
    """Draw no, one or two pixels off an object, on other objects or anywhere."""
    free = 1 - cv2.dilate(mask, _NEAR)
    others, number = free * (scene.whole > 0).astype(np.uint8), rng.choice(3, p=[0.7, 0.18, 0.12])
    areas = [others if rng.random() < 0.6 and others.any() else free for _ in range(number)]
    return [_inside(rng, area) for area in areas if area.any()]


def _predicted(rng: Random, expected: Array) -> Array:
    """Draw places along an object as predicted for a frame, up to 3 pixels off; at times there are none."""
    number, inside = rng.integers(4, 33) if rng.random() < 0.85 else 0, (expected > 0.5).astype(np.uint8)
    places = [_inside(rng, inside) for _ in range(number)] if inside.any() else []
    return np.array(places, np.float32).reshape(-1, 2) + rng.uniform(-1, 1, (len(places), 2)) * rng.uniform(0, 3)


def _expected(rng: Random, mask: Array, kind: str) -> Array:
    """Return a mask as a track expects it: moved and bent, thinner or thicker, with pieces missing; often partly wrong.

    A track that follows what the network answered to it must not be believed by the network: its errors would stay.
    """
    if kind != "rope" and rng.random() < 0.6:  # a track of an outline has no holes
        contours = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
        mask = cv2.drawContours(np.zeros_like(mask), contours, -1, 1, cv2.FILLED)
    matrix = cv2.getRotationMatrix2D((WIDTH / 2, HEIGHT / 2), rng.normal(0, 2), 1 + rng.normal(0, 0.015))
    matrix[:, 2] += rng.normal(0, rng.uniform(0, 6), 2)
    grid = np.stack([*np.mgrid[0:HEIGHT, 0:WIDTH][::-1], np.ones(SHAPE)], -1)  # (h, w, 3): x, y, 1
    bend = cv2.resize(rng.standard_normal((4, 5, 2)), (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    direction, point = rng.standard_normal(2), np.argwhere(mask)[rng.integers(np.count_nonzero(mask)), ::-1]
    beyond = (grid[..., :2] - point) @ (direction / np.linalg.norm(direction))  # pixels, on one side of a line
    source = grid @ matrix.T + bend * rng.uniform(0, 4)
    if rng.random() < 0.4:  # on one side of a line the track is wrong
        shift = rng.normal(0, 20, 2) + bend * rng.uniform(0, 25)
        source += shift * np.clip(beyond / rng.uniform(10, 60), 0, 1)[..., None]
    x, y = np.moveaxis(source, -1, 0).astype(np.float32)
    moved, change = cv2.remap(mask, x, y, cv2.INTER_NEAREST), rng.random()
    if change < 0.4:
        size = int(rng.integers(2, 8))
        moved = cv2.dilate(moved, np.ones((size, size))) if change < 0.25 else cv2.erode(moved, np.ones((2, 2)))
    if rng.random() < 0.15:  # nothing on one side of the line
        moved[beyond > 0] = 0
    for _ in range(rng.integers(0, 4) if rng.random() < 0.5 else 0):
        cv2.circle(moved, rng.integers((WIDTH, HEIGHT)).tolist(), int(rng.integers(5, 40)), 0, -1)
    if rng.random() < 0.1:  # all of it is elsewhere
        moved = cv2.warpAffine(moved, np.array([[1, 0, rng.normal(0, 40)], [0, 1, rng.normal(0, 40)]]), (WIDTH, HEIGHT))
    return cv2.GaussianBlur(moved.astype(np.float32), (0, 0), rng.uniform(0.1, 1.2))


def _inside(rng: Random, mask: Array) -> Array:
    """Draw a pixel (x, y) of a mask, mostly near its middle line."""
    places = rng.choice(np.argwhere(mask), 6)  # (6, 2): y, x
    depth = cv2.distanceTransform(mask, cv2.DIST_L2, 3)[tuple(places.T)]
    return places[depth.argmax() if rng.random() < 0.85 else 0, ::-1]


def _largest(error: Array) -> Array:
    """Return the largest connected part of an error, without its outermost pixels; all zero if there is none."""
    count, label, stats, _ = cv2.connectedComponentsWithStats(cv2.erode(error.astype(np.uint8), np.ones((3, 3))))
    largest = 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax()) if count > 1 else -1
    return (label == largest).astype(np.uint8)
