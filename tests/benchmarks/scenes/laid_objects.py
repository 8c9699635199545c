"""Lay strands and sheets on a ground: what is on top at each pixel, its reflectance, its slope and its height.

Curves and outlines are in pixels of the photo, (u, v); the raster is twice as fine.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.scenes import resample
from shape_obs.compiled import compiled
from tests.benchmarks.scenes.grounds import raster
from tests.benchmarks.scenes.height_field import FINER, Array, Field, Size, grain

Make = Literal["smooth", "twisted", "braided", "ribbed", "marked", "flat"]
Print = Literal["plain", "stripes", "checks", "motif", "heather", "text"]
Owner = npt.NDArray[np.int8]
Bits = npt.NDArray[np.int32]
THING: Final = 100  # owner of all that is no object: hands, tools, boxes
SLEEVE: Final = 50  # plus the object's number: owner of its heat-shrink tubes and taped ends
_JUST_LAID: Final = 127
_SLOPE: Final = np.array([[-0.5, 0, 0.5]], np.float32)  # differences to the right
_STEP: Final = 0.5  # pixels of the raster from one sample of a strand to the next


@dataclass(frozen=True)
class Look:
    """How a surface looks."""

    colour: Field  # (3,) linear reflectance
    second: Field  # (3,) of marks and prints
    gloss: float = 0.1  # strength of highlights, 0 to 1
    make: Make = "smooth"
    pattern: Print = "plain"
    wrinkles: float = 0.0  # slope of a sheet's folds
    seed: int = 0  # of all that is drawn at random on it


@dataclass(frozen=True)
class Strand:
    """A rope, a wire, a band or a finger."""

    curve: Array  # (P, 2) axis; a closed one ends where it begins
    width: float  # pixels of the photo
    lift: Array  # (P,) height of the lower side over the ground, pixels
    look: Look
    rounded: bool = False  # whether the tips are half discs
    sleeves: tuple[tuple[float, float], ...] = ()  # from and to, shares of the length


@dataclass(frozen=True)
class Sheet:
    """A towel, a garment, a piece of paper or a box seen from above."""

    outline: Array  # (P, 2)
    rest: Array  # (P, 2) the outline in the place where its prints and folds were drawn
    look: Look
    thick: float = 2.0  # pixels
    flap: Array | None = None  # (Q, 2) outline of a corner that is folded over


class Pile:
    """What lies on a ground, seen from above."""

    def __init__(self, ground: Field) -> None:
        self.size: Size = (ground.shape[0], ground.shape[1])
        self.albedo: Field = ground.copy()  # (2H, 2W, 3) linear reflectance
        self.slope: Field = np.zeros((*self.size, 2), np.float32)  # horizontal part of the unit normal: right, down
        self.height: Field = np.zeros(self.size, np.float32)  # pixels of the photo
        self.gloss: Field = np.full(self.size, 0.03, np.float32)
        self.owner = np.full(self.size, -1, np.int8)  # number of the object on top, THING, SLEEVE + number, or -1
        self.covered = np.zeros(self.size, np.int32)  # bit k: object k lies here, on top or not
        self._where: Field = np.zeros((*self.size, 3), np.float32)  # along, across, heading

    def add(self, each: Strand | Sheet, owner: int) -> None:
        """Lay a sheet over all that is there, or a strand as high as its lift puts it."""
        if isinstance(each, Sheet):
            self._lay(each, owner)
            return
        self._sweep(each, owner, each.curve, each.lift, each.width)
        for begin, end in each.sleeves:
            first = int(begin * len(each.curve))
            part = slice(first, max(int(end * len(each.curve)), first + 2))
            self._sweep(each, SLEEVE + owner, each.curve[part], each.lift[part], 1.2 * each.width + 0.6)

    def _sweep(self, strand: Strand, owner: int, curve: Array, lift: Array, width: float) -> None:
        axis = resample(np.column_stack([(curve + 0.5) * FINER - 0.5, lift]), _STEP)
        half = np.full(len(axis), FINER * width / 2)
        along = np.arange(len(axis)) * _STEP
        if strand.look.make in ("twisted", "braided"):
            half *= 1 + 0.05 * np.sin(2 * np.pi * along / (1.3 * half[0]))
        if strand.rounded:
            tip = np.clip(1 - np.minimum(along, along[::-1]) / half[0], 0, 1)
            half *= np.sqrt(1 - tip**2)
        dome = 0.0 if strand.look.make == "flat" else 1 / FINER
        bit = 1 << owner if owner < SLEEVE else 0
        _swept(axis, half, dome, _JUST_LAID, bit, self.height, self.owner, self._where, self.covered)
        box = self._box(axis[:, :2].min(axis=0) - half.max(), axis[:, :2].max(axis=0) + half.max())
        on = self.owner[box] == _JUST_LAID
        self.owner[box][on] = owner
        place = self._where[box][on]
        colour, tilt = _strand_surface(strand.look, place[:, 0] / np.float32(FINER), place[:, 1], width)
        if owner >= SLEEVE and owner != THING:
            colour, tilt = np.broadcast_to(strand.look.second, colour.shape), np.zeros_like(tilt)
        cos, sin = np.cos(place[:, 2]), np.sin(place[:, 2])
        across = place[:, 1] * np.float32(0.25 if strand.look.make == "flat" else 0.96)
        self.albedo[box][on] = colour
        self.slope[box][on] = np.stack([cos * tilt - sin * across, cos * across + sin * tilt], axis=1)
        self.gloss[box][on] = strand.look.gloss

    def _box(self, low: Array, high: Array) -> tuple[slice, slice]:
        """Return the part of the raster between two places (u, v), and a few pixels around."""
        first = np.clip(np.floor(low).astype(int) - 4, 0, self.size[::-1]).tolist()
        last = np.clip(np.ceil(high).astype(int) + 5, 0, self.size[::-1]).tolist()
        return slice(first[1], last[1]), slice(first[0], last[0])

    def _lay(self, sheet: Sheet, owner: int) -> None:
        flap = [] if sheet.flap is None else [(sheet.flap, 2 * sheet.thick, 0.82)]
        box = self._box(sheet.outline.min(axis=0) * FINER, sheet.outline.max(axis=0) * FINER)
        height, width = self.height[box].shape
        if not height * width:
            return
        origin = np.array([box[1].start, box[0].start])
        start = np.floor(sheet.rest.min(axis=0) * FINER)
        moved, _ = cv2.estimateAffine2D(sheet.rest * FINER - start, sheet.outline * FINER - origin)
        surface = _sheet_surface(sheet.look, sheet.rest * FINER - start)
        albedo, bumps = (cv2.warpAffine(e, moved, (width, height), borderMode=cv2.BORDER_REFLECT) for e in surface)
        bumps *= np.float32(sheet.look.wrinkles)
        for outline, thick, back in [(sheet.outline, sheet.thick, 1.0), *flap]:
            shape = np.zeros((height, width), np.uint8)
            cv2.fillPoly(shape, [np.round((outline * FINER - origin) * 16).astype(np.int32)], (1,), shift=4)
            inside = np.asarray(cv2.distanceTransform(np.pad(shape, 1), cv2.DIST_L2, 3))[1:-1, 1:-1]
            on, edge = shape > 0, np.clip(inside / 5, 0, 1)
            hem = 1 - 0.18 * (np.abs(inside - 13) < 1.3) * (sheet.look.wrinkles > 0)
            bump = cv2.GaussianBlur(edge, (0, 0), 1.5) * 2 + bumps
            right, down = (cv2.filter2D(bump, -1, tap) for tap in (_SLOPE, _SLOPE.T))
            long = np.sqrt(1 + right**2 + down**2)
            self.albedo[box][on] = (albedo * (hem * back).astype(np.float32)[..., None])[on]
            self.slope[box][on] = np.stack([-right / long, -down / long], axis=-1)[on]
            self.height[box][on] += (thick * np.maximum(edge, 0.3) + np.maximum(bumps, 0))[on]
            self.owner[box][on], self.gloss[box][on] = owner, sheet.look.gloss
            self.covered[box][on] |= 1 << owner if owner < SLEEVE else 0


@compiled("(f8[:,::1], f8[::1], f8, i8, i8, f4[:,::1], i1[:,::1], f4[:,:,::1], i4[:,::1])")
def _swept(
    axis: Array,
    half: Array,
    dome: float,
    owner: int,
    bit: int,
    height: Field,
    owners: Owner,
    where: Field,
    covered: Bits,
) -> None:
    """Sweep a round or flat section along an axis (u, v, lift); the higher surface stays."""
    rows, columns = height.shape
    last = len(axis) - 1
    for i in range(last + 1):
        before, after = axis[max(i - 3, 0)], axis[min(i + 3, last)]
        du, dv = after[0] - before[0], after[1] - before[1]
        long = max(np.hypot(du, dv), 1e-9)
        du, dv, heading = du / long, dv / long, np.arctan2(dv, du)
        count = int(np.ceil(2 * half[i])) + 1
        for j in range(-count, count + 1):
            across = j / count
            u = int(np.floor(axis[i, 0] - dv * across * half[i] + 0.5))
            v = int(np.floor(axis[i, 1] + du * across * half[i] + 0.5))
            if 0 <= u < columns and 0 <= v < rows:
                covered[v, u] |= bit
                top = axis[i, 2] + half[i] * (dome * (1 + np.sqrt(1 - across * across)) + 0.1)
                if top > height[v, u]:
                    height[v, u], owners[v, u] = top, owner
                    where[v, u, 0], where[v, u, 1], where[v, u, 2] = _STEP * i, across, heading


def _strand_surface(look: Look, along: Array | Field, across: Field, width: float) -> tuple[Field, Field]:
    """Return the reflectance ``(K, 3)`` and the tilt along a strand ``(K,)`` at places on it.

    The places are ``along``, pixels from its begin, and ``across``, -1 to 1; the width is in pixels.
    """
    rng, around = np.random.default_rng(look.seed), np.arcsin(np.clip(across, -1, 1)) / np.pi  # half turns
    dark, tilt, mix = np.ones_like(along), np.zeros_like(along), np.zeros_like(along)
    if look.make == "twisted":
        turn = np.pi * (along / (rng.uniform(0.5, 0.8) * width) + rng.choice([-1.0, 1.0]) * 1.3 * around)
        dark, tilt = 0.45 + 0.55 * np.abs(np.sin(turn)) ** 0.6, 0.5 * np.cos(turn) * np.sign(np.sin(turn))
    elif look.make == "braided":
        one, two = along / (0.9 * width) + 1.5 * around, along / (0.9 * width) - 1.5 * around
        dark = 0.72 + 0.28 * np.sign(np.sin(np.pi * one) * np.sin(np.pi * two)) * np.abs(np.sin(2 * np.pi * one))
        tilt = 0.3 * np.cos(2 * np.pi * one)
        mix = ((np.floor(one) % 4 == 0) if rng.random() < 0.3 else np.zeros_like(one)) * 0.9
    elif look.make == "ribbed":
        dark, tilt = 0.7 + 0.3 * np.abs(np.sin(np.pi * along / 5)), 0.4 * np.cos(2 * np.pi * along / 5)
    elif look.make == "marked":
        mix = (np.abs(across - rng.uniform(-0.4, 0.4)) < 0.2) * 0.85
    worn = np.exp(0.04 * rng.standard_normal(4096))[(along * 3 + 40 * across).astype(np.int64) % 4096]
    colour = (look.colour * (1 - mix[:, None]) + look.second * mix[:, None]) * (dark * worn)[:, None]
    return np.asarray(colour, np.float32), np.asarray(np.clip(tilt, -0.6, 0.6), np.float32)


def _sheet_surface(look: Look, outline: Array) -> tuple[Field, Field]:
    """Return the reflectance ``(h, w, 3)`` of the box around a sheet, and its bumps ``(h, w)`` for a slope of 1."""
    rng, high = np.random.default_rng(look.seed), outline.max(axis=0)
    size = int(high[1]) + 1, int(high[0]) + 1
    a, b = raster(rng, size, 0.5)
    mix = np.zeros(size, np.float32)
    if look.pattern in ("stripes", "checks"):
        pitch, share = rng.uniform(20, 90), rng.uniform(0.25, 0.6)
        mix = (a / pitch % 1 < share).astype(np.float32)
        if look.pattern == "checks":
            mix = 0.5 * mix + 0.5 * (b / pitch % 1 < share)
    elif look.pattern == "heather":
        mix = np.clip(0.3 + 0.25 * grain(rng, size, (6, 2))[..., 0], 0, 1)
    elif look.pattern == "motif":
        centre, reach = (0.5 + rng.normal(0, 0.05, 2)) * high, 0.12 * high.min()
        for _ in range(int(rng.integers(2, 7))):
            at = np.round(centre + rng.normal(0, reach, 2)).astype(int).tolist()
            axes = (rng.uniform(0.3, 1, 2) * reach).astype(int).tolist()
            cv2.ellipse(mix, at, axes, rng.uniform(0, 180), 0, 360, (1.0,), -1)
    elif look.pattern == "text":
        line, word = b / 26 % 1, rng.random(997)[((b // 26) * 37 + a // 19).astype(int) % 997]
        mix = ((line > 0.45) & (line < 0.75) & (word > 0.25) & (np.sin(a * 1.3) > -0.4)) * 0.75
    weave = np.exp(0.03 * grain(rng, size, (2, 2)))
    albedo = (look.colour + (look.second - look.colour) * mix[..., None]) * weave
    bumps = np.zeros(size, np.float32)
    if look.wrinkles > 0:
        for long, wide, high_ in ((420, 90, 26.0), (160, 34, 11.0), (50, 22, 3.0)):
            turned = cv2.getRotationMatrix2D((size[1] / 2, size[0] / 2), rng.uniform(0, 180), 1.7)
            folds = grain(rng, size, (long, wide))[..., 0] * np.float32(high_)
            bumps += cv2.warpAffine(folds, turned, size[::-1], borderMode=cv2.BORDER_REFLECT)
    return np.asarray(albedo, np.float32), bumps
