"""Draw photos, and sequences, of one object among others: ropes and wires, sheets, garments and rings, with the truth.

What makes real photos hard is in them: patterned grounds, objects of like colours that cross, light from one side,
soft shadows, hands and tools, and a camera with its noise, its colours and its files. Nothing of it comes from a
picture.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final, Literal, get_args

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.scenes import SIZE
from tests.benchmarks.scenes.grounds import GROUNDS, ground, one_of
from tests.benchmarks.scenes.height_field import FINER, SQUARE, Array, Field, Image, axes, unit
from tests.benchmarks.scenes.laid_objects import SLEEVE, THING, Look, Make, Pile, Print, Sheet, Strand
from tests.benchmarks.scenes.room_camera import Camera, Light
from tests.benchmarks.scenes.things import bent, clutter, gripper, hand, moved

Kind = Literal["rope", "wire", "sheet", "garment", "ring"]
KINDS: Final = get_args(Kind)
THIN: Final = ("rope", "wire")
Mask = npt.NDArray[np.bool_]
Random = np.random.Generator
Object = Strand | Sheet

_JACKETS: Final = "c3272f 17181a e6e5e1 2b56a8 2f8f4e e0b52c d9772a 6b4a2f 8d9094 d9c9a6 7a3f8f 4b4e52 b7c7d6 efe3c0"
_FABRICS: Final = "d8d3c8 2c3f66 9c2f36 5c7f6b 30323a c7a24f b9bec6 7fa3bf e3c4c0 6d5a4a efeee9 4e6f8f 9a9184"
_TRIES: Final = 12  # scenes from which one is taken in which the object is well in sight
_SEEN: Final = (0.0035, 0.75)  # least share of the photo, and least share of the object that nothing lies over
_CONTRAST: Final = 11.0  # least distance in Lab of the object's border from what is around it
_OWN: Final = (12.0, 0.003)  # distance of colours, half of the lightness; share of the photo that may have them
_ALONG: Final = 0.06  # share of a rope that may lie along other ones
_CROSSES: Final = np.radians(25)  # a smaller angle is no crossing
_TIP: Final = 0.75  # widths
_LEEWAY: Final = 3  # pixels around the object in which colours mix


@dataclass(frozen=True)
class ObjectPhoto:
    """A drawn photo."""

    rgb: Image  # (H, W, 3) uint8
    mask: Mask  # (H, W) bool, where the object is seen
    ignored: Mask  # (H, W) bool, what does not count: the object under something else, and its taped ends
    kind: Kind  # what the object is
    centreline: Array  # (P, 2) visible pixels (u, v) of the axis of a rope or wire; (0, 2) of others
    width: float  # of a rope or wire, pixels; 0 of others

    def has_own_colour(self) -> bool:
        """Return whether nothing else of some size has a colour of the object."""
        lab = cv2.cvtColor(cv2.GaussianBlur(self.rgb, (0, 0), 1.0).astype(np.float32) / 255, cv2.COLOR_RGB2LAB)
        lab = lab * np.array([0.5, 1, 1], np.float32)
        near = cv2.dilate((self.mask | self.ignored).view(np.uint8), np.ones((2 * _LEEWAY + 1,) * 2, np.uint8)) > 0
        cells, counts = np.unique(np.round(lab[self.mask] / 4), axis=0, return_counts=True)
        colours = 4 * cells[counts > 0.01 * counts.sum()].astype(np.float32)
        same = np.any([((lab[~near] - colour) ** 2).sum(axis=1) < _OWN[0] ** 2 for colour in colours], axis=0)
        return int(np.count_nonzero(same)) < _OWN[1] * lab[..., 0].size


@dataclass(frozen=True)
class Setting:
    """Objects on a ground, the light and the camera."""

    ground: Field
    objects: tuple[Object, ...]
    kinds: tuple[Kind, ...]
    below: tuple[Object, ...]  # things that lie under the objects
    above: tuple[Object, ...]  # things that lie over them
    light: Light
    camera: Camera

    def photo(self, rng: Random, target: int) -> ObjectPhoto:
        """Take a photo; one of the objects is what is looked for."""
        pile = Pile(self.ground)
        for each in self.below:
            pile.add(each, THING)
        for k, each in enumerate(self.objects):
            if isinstance(each, Sheet):
                pile.add(each, k)
        under = pile.height.copy()
        for k, each in enumerate(self.objects):
            if isinstance(each, Strand):
                pile.add(replace(each, lift=each.lift + _height_below(under, each)), k)
        for each in self.above:
            pile.add(each, THING)
        rgb = self.camera.take(rng, self.light.on(pile))
        own = pile.owner == target
        aside = ((pile.covered >> target) & 1 > 0) & ~own | (pile.owner == SLEEVE + target)
        mask, each = _reduced(own) > 0.5, self.objects[target]
        ignored = (_reduced(aside) > 0.25) & ~mask
        axis, width = np.zeros((0, 2)), 0.0
        if isinstance(each, Strand) and self.kinds[target] in THIN:
            inset = round(_TIP * each.width)  # tips, and what the photo's border cuts, have no certain axis
            axis, width = each.curve[inset : len(each.curve) - inset], each.width
            at = np.round(axis).astype(int)
            inside = ((at >= width / 2) & (at < np.array(SIZE[::-1]) - width / 2)).all(axis=1)
            axis, at = axis[inside], at[inside]
            axis = axis[mask[at[:, 1], at[:, 0]]]
        return ObjectPhoto(rgb, mask, ignored, self.kinds[target], axis, width)


def object_photos(count: int, seed: int) -> Iterator[ObjectPhoto]:
    """Yield ``count`` photos that go through all kinds of objects and grounds, three in five of ropes and wires."""
    turns: tuple[Kind, ...] = ("wire", "rope", "sheet", "wire", "ring", "rope", "garment", "wire", "rope", "sheet")
    names = list(GROUNDS)
    for k in range(count):
        yield object_photo(np.random.default_rng([seed, k]), turns[k % len(turns)], names[k % len(names)])


def object_photo(rng: Random, kind: Kind, ground: str) -> ObjectPhoto:
    """Draw a photo of 640 x 480 pixels of one kind of object on a ground of ``GROUNDS``."""
    return _found(rng, kind, ground)[2]


def object_sequence(rng: Random, kind: Kind, ground: str, frames: int = 100) -> Iterator[ObjectPhoto]:
    """Yield photos of an object that moves while the light changes by 20 %, a hand passes, and then a shadow."""
    setting, target, _ = _found(rng, kind, ground)
    sway = [(unit(rng.normal(size=2)) * rng.uniform(5, 14), rng.normal(0, 0.006, 2), rng.uniform(0.03, 0.07), phase)
            for phase in rng.uniform(0, 6, 3)]  # fmt: skip
    passing, angle = hand(rng, np.zeros(2), rng.uniform(0, 2 * np.pi)), rng.uniform(0, 2 * np.pi)
    shade, centre = setting.light.new_shadow(rng), np.array(SIZE[::-1]) / 2
    side, way = rng.uniform(-160, 160), np.array([np.cos(angle), np.sin(angle)])

    def swayed(points: Array, k: int) -> Array:
        places = [points @ wave + phase for _, wave, _, phase in sway]
        shifts = (reach * (np.sin(place + pace * k) - np.sin(place))[:, None]
                  for place, (reach, _, pace, _) in zip(places, sway, strict=True))  # fmt: skip
        return points + sum(shifts)

    for k in range(frames):
        share = k / max(frames - 1, 1)
        objects = list(setting.objects)
        objects[target] = moved(objects[target], partial(swayed, k=k))
        over, shadows = setting.above, setting.light.shadows
        if 0.2 < share < 0.55:
            at = centre + way * np.interp(share, (0.2, 0.55), (-520, 520)) + side * way[::-1] * (-1, 1)
            over += tuple(moved(each, lambda points, at=at: points + at) for each in passing)
        if 0.55 < share < 0.95:
            at = way[::-1] * np.interp(share, (0.55, 0.95), (-600, 600))
            shadows += (replace(shade, outline=shade.outline + at),)
        light = replace(setting.light, level=1 + 0.2 * np.sin(2 * np.pi * share * 1.5), shadows=shadows)
        yield replace(setting, objects=tuple(objects), above=over, light=light).photo(rng, target)


def _found(rng: Random, kind: Kind, name: str) -> tuple[Setting, int, ObjectPhoto]:
    """Return a setting, the number of an object of a kind in it that a person would find, and its photo."""
    best: tuple[float, Setting, int, ObjectPhoto] | None = None
    for _ in range(_TRIES):
        setting = _setting(rng, kind, name)
        target = int(rng.choice([k for k, each in enumerate(setting.kinds) if each == kind]))
        photo = setting.photo(rng, target)
        shown, hidden = float(photo.mask.mean()), float(photo.ignored.mean())
        found = min(shown / _SEEN[0], shown / (shown + hidden + 1e-9) / _SEEN[1], _contrast(photo) / _CONTRAST)
        if best is None or found > best[0]:
            best = found, setting, target, photo
        if found >= 1:
            break
    assert best is not None
    return best[1:]


def _contrast(photo: ObjectPhoto) -> float:
    """Return the distance in Lab of an object from what is around it."""
    reach = np.ones((2 * 4 * _LEEWAY + 1,) * 2, np.uint8)
    around = (cv2.dilate(photo.mask.view(np.uint8), reach) > 0) & ~photo.mask & ~photo.ignored
    if not photo.mask.any() or not around.any():
        return 0.0
    lab = cv2.cvtColor(photo.rgb.astype(np.float32) / 255, cv2.COLOR_RGB2LAB)
    return float(np.linalg.norm(np.median(lab[photo.mask], axis=0) - np.median(lab[around], axis=0)))


def _reduced(fine: Mask) -> Field:
    """Return the share of each pixel of the photo."""
    return np.asarray(cv2.resize(fine.astype(np.float32), SIZE[::-1], interpolation=cv2.INTER_AREA), np.float32)


def _height_below(under: Field, strand: Strand) -> Array:
    """Return how high a strand is raised by what it lies on, smoothly, at the points of its curve."""
    low = cv2.blur(cv2.dilate(under[::8, ::8], np.ones((3, 3), np.uint8)), (5, 5))
    at = np.clip(np.round(strand.curve * FINER / 8).astype(int), 0, np.array(low.shape[::-1]) - 1)
    return low[at[:, 1], at[:, 0]].astype(np.float64)


def _setting(rng: Random, kind: Kind, name: str) -> Setting:
    """Draw a setting with at least one object of a kind."""
    field = ground(rng, name, (SIZE[0] * FINER, SIZE[1] * FINER))
    objects = _MAKERS[kind](rng)
    kinds: tuple[Kind, ...] = tuple(kind for _ in objects)
    if rng.random() < 0.25:
        other: Kind = "wire" if kind != "wire" else "rope"
        some = _MAKERS[other](rng)[:2]
        others: tuple[Kind, ...] = tuple(other for _ in some)
        objects, kinds = objects + some, kinds + others
    below = clutter(rng, int(rng.integers(5, 16)) if rng.random() < 0.3 else int(rng.integers(0, 3)))
    above: list[Object] = []
    if rng.random() < 0.3:  # something grips an object, or comes near it
        first = objects[0]
        points = first.curve if isinstance(first, Strand) else first.outline
        at = points[int(rng.integers(len(points)))] + rng.normal(0, 12, 2)
        away = float(np.arctan2(*(np.array(SIZE[::-1]) / 2 - at)[::-1])) + rng.normal(0, 0.4)
        above += hand(rng, at, away) if rng.random() < 0.6 else gripper(rng, at, away)
    light = Light.drawn(rng)
    return Setting(field, tuple(objects), kinds, tuple(below), tuple(above), light, Camera(rng, field))


def _colour(rng: Random, colours: str) -> Field:
    return one_of(rng, colours) * np.exp(rng.normal(0, 0.12, 3)).astype(np.float32)


def _looks(rng: Random, count: int, makes: Sequence[Make], gloss: float, *, unlike: bool = False) -> list[Look]:
    """Return the looks of strands: of any colours, or, one time in four, some that are nearly or exactly the same."""
    like = float(rng.choice([0.0, 0.06, 0.25])) if rng.random() < 0.25 and not unlike else None
    looks: list[Look] = []
    for _ in range(count):
        colour, make = _colour(rng, _JACKETS), makes[int(rng.integers(len(makes)))]
        if looks and like is not None and rng.random() < 0.6:
            colour, make = looks[0].colour * np.exp(rng.normal(0, like, 3)).astype(np.float32), looks[0].make
        second = _colour(rng, _JACKETS)
        looks.append(Look(colour, second, float(rng.uniform(0.2, 1) * gloss), make, seed=int(rng.integers(1 << 30))))
    return looks


def _strands(rng: Random, curves: list[Array], widths: list[float], looks: list[Look]) -> list[Object]:
    """Return strands that go over and under one another, some with heat-shrink tubes or taped ends."""
    most, strands = max(widths), list[Object]()
    for curve, width, look in zip(curves, widths, looks, strict=True):
        share = np.linspace(0, len(curve) / 160, len(curve))
        wave = sum(np.sin(share * pace + rng.uniform(0, 6)) for pace in (1.0, 1.7, 2.9))
        lift = most * rng.uniform(0.9, 1.2) * (0.5 + 0.5 * np.tanh(2.5 * np.asarray(wave)))
        sleeves = [pair for pair in ((0.0, 0.03), (0.97, 1.0)) if rng.random() < 0.2]
        strands.append(Strand(curve, width, lift, look, bool(rng.random() < 0.5), tuple(sleeves)))
    return strands


def _ropes(rng: Random) -> list[Object]:
    count = int(rng.choice([1, 2, 3, 4], p=[0.35, 0.3, 0.2, 0.15]))
    width = np.exp(rng.uniform(np.log(9), np.log(40 if count < 3 else 24)))
    widths = (width * rng.uniform(0.8, 1.2, count)).tolist()
    looks = _looks(rng, count, ("twisted", "braided", "smooth", "twisted", "ribbed", "braided"), 0.15)
    return _strands(rng, _bent_apart(rng, widths), widths, looks)


def _bent_apart(rng: Random, widths: list[float]) -> list[Array]:
    """Return axes of ropes or wires that cross, and seldom lie along one another."""
    curves, ways = list[Array](), list[Array]()
    for width in widths:
        curve = way = np.zeros((0, 2))
        for _ in range(_TRIES):
            curve = bent(rng, width)
            way = np.gradient(curve, axis=0)
            if not curves:
                break
            others, theirs = np.concatenate(curves)[::5], np.concatenate(ways)[::5]
            near = np.linalg.norm(curve[::5, None] - others, axis=2) < 0.6 * (width + max(widths))
            if (near & (np.abs(way[::5] @ theirs.T) > np.cos(_CROSSES))).any(axis=1).mean() < _ALONG:
                break
        curves.append(curve)
        ways.append(way)
    return curves


def _wires(rng: Random) -> list[Object]:
    """Return wires that cross, or, now and then, a harness whose wires run side by side."""
    count = int(rng.choice(6, p=(0.2, 0.25, 0.2, 0.15, 0.1, 0.1))) + 1
    width = float(np.exp(rng.uniform(np.log(3.2), np.log(11))))
    harness = count > 2 and rng.random() < 0.2
    looks = _looks(rng, count, ("smooth", "smooth", "smooth", "braided", "marked"), 0.8, unlike=harness)
    width = max(width, 5.0) if harness else width
    if not harness:
        widths = [width * float(rng.uniform(0.75, 1.3)) for _ in range(count)]
        return _strands(rng, _bent_apart(rng, widths), widths, looks)
    axis = bent(rng, 6 * width)
    way = np.gradient(axis, axis=0)
    normal, share = np.stack([-way[:, 1], way[:, 0]], axis=1), np.linspace(0, 1, len(axis))
    curves = []
    for place in rng.permutation(count) - (count - 1) / 2:
        fan = sum(rng.uniform(0, 4) * np.clip(np.abs(share - end) * -4 + 1, 0, 1) ** 2 for end in (0, 1))
        sway = rng.uniform(0, 0.5) * np.sin(share * rng.uniform(4, 20) + rng.uniform(0, 6))
        curves.append(axis + (width * (place * (rng.uniform(1.15, 1.5) + fan) + sway))[:, None] * normal)
    return _strands(rng, curves, [width] * count, looks)


def _rings(rng: Random) -> list[Object]:
    """Return closed bands, hoops and rings."""
    rings = list[Object]()
    around = np.linspace(0, 2 * np.pi, 700)
    for look in _looks(rng, int(rng.integers(1, 4)), ("flat", "smooth", "smooth", "braided", "ribbed"), 0.5):
        radius = rng.uniform(45, 150)
        waves = [rng.uniform(0, 0.16) / k * np.cos(k * around + rng.uniform(0, 6)) for k in (2, 3, 4)]
        out = radius * (1 + np.sum(waves, axis=0))
        centre = rng.uniform((0.25, 0.25), (0.75, 0.75)) * SIZE[::-1]
        curve = centre + out[:, None] * np.stack([np.cos(around), np.sin(around)], axis=1)
        width = float(max(rng.uniform(0.12, 0.4) * radius, 18))
        rings.append(Strand(curve, width, np.full(700, rng.uniform(0, width)), look))
    return rings


def _sheet(rng: Random, garment: bool) -> Sheet:
    """Return a towel or a garment, a corner of it sometimes folded over."""
    if garment:
        outline = _GARMENTS[int(rng.integers(len(_GARMENTS)))] * rng.uniform(0.85, 1.15, 2)
    else:
        outline = SQUARE * (1, rng.uniform(0.55, 1.0))
    sides = zip(outline, np.roll(outline, -1, axis=0), strict=True)
    around = np.concatenate([np.linspace(a, b, 40, endpoint=False) for a, b in sides])
    kernel = np.hanning(int(rng.integers(5, 13)))
    padded = np.concatenate([around[-8:], around, around[:8]])
    around = np.stack([np.convolve(c, kernel / kernel.sum(), "same") for c in padded.T], axis=1)[8:-8]
    for k in (2, 3, 5, 8):
        wave = np.sin(around[:, ::-1] * k * rng.uniform(0.6, 1.4, 2) + rng.uniform(0, 6, 2))
        around = around + rng.uniform(0, 0.09) / k * wave
    turn, reach = rng.uniform(0, 2 * np.pi), rng.uniform(100, 210)
    around = around @ axes(turn) * reach + rng.uniform((0.35, 0.4), (0.65, 0.6)) * SIZE[::-1]
    flap, rest = None, around
    if rng.random() < (0.15 if garment else 0.45):
        corner = around[40 * int(rng.integers(len(outline)))]
        inward = unit(around.mean(axis=0) - corner)
        beyond = (corner + inward * rng.uniform(0.2, 0.5) * reach - around) @ inward
        flap = (around + 2 * np.maximum(beyond, 0)[:, None] * inward)[beyond > 0]
        around = around + np.maximum(beyond, 0)[:, None] * inward
        start = int(np.argmax(np.linalg.norm(np.diff(flap, axis=0, append=flap[:1]), axis=1))) + 1
        flap = np.roll(flap, -start, axis=0)
    patterns: tuple[Print, ...] = ("plain", "plain", "plain", "stripes", "checks", "motif", "heather")
    look = Look(_colour(rng, _FABRICS), _colour(rng, _FABRICS), 0.03, pattern=patterns[int(rng.integers(7))],
                wrinkles=float(rng.uniform(0.1, 0.9)), seed=int(rng.integers(1 << 30)))  # fmt: skip
    return Sheet(around, rest, look, flap=flap)


_GARMENTS: Final = tuple(
    np.array([(x, y) for x, y in half] + [(-x, y) for x, y in half[::-1]])
    for half in (
        ((0.18, -0.9), (0.4, -1.0), (1.05, -0.55), (0.85, -0.2), (0.55, -0.4), (0.55, 1.0)),  # a shirt
        ((0.45, -1.0), (0.75, 1.0), (0.3, 1.0), (0.05, -0.35)),  # trousers
        ((0.5, -0.7), (0.8, 0.7), (0.15, 0.7), (0.04, 0.0)),  # shorts
        ((0.15, -1.0), (0.35, -1.0), (0.35, -0.4), (0.8, 1.0)),  # a dress
        ((0.15, -0.9), (0.38, -1.0), (1.0, 0.55), (0.75, 0.65), (0.5, -0.1), (0.52, 0.9)),  # a jumper
    )
)
_MAKERS: Final[dict[Kind, Callable[[Random], list[Object]]]] = {
    "rope": _ropes,
    "wire": _wires,
    "ring": _rings,
    "sheet": lambda rng: [_sheet(rng, garment=False) for _ in range(rng.integers(1, 3))],
    "garment": lambda rng: [_sheet(rng, garment=True) for _ in range(rng.integers(1, 3))],
}
