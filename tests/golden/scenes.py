"""Draw the streams: ropes, blobs and sheets that move before a camera, under hands, with depth, clutter and gaps.

Everything is a function of time in seconds, so that a stream may have any frame rate.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import Any, Final, Literal, NamedTuple, Protocol

import cv2
import numpy as np
import numpy.typing as npt
from scipy.interpolate import LinearNDInterpolator

from shape_obs import CameraModel, Intrinsics
from shape_obs.bench.scenes import draw_blob, draw_sheet
from tests.golden.streams import Stream, Truth
from tests.scenes.hidden_ropes import see

Array = npt.NDArray[Any]
Triple = tuple[float, float, float]

ROPE_POINTS: Final = 181  # of which the truth keeps every third
_OUTLINE: Final = np.arange(360) * np.pi / 180  # of which the truth keeps every second
_SIDE: Final = 13  # points along a side of a sheet
_HAND: Final = 0.08  # metres from a hand to the nearest object
_KEPT: Final = 9  # pixels around the objects where noisy depth and noisy pictures are kept


class Layer(NamedTuple):
    """One object in one frame: mask ``(H, W)`` bool, depth in metres, 0 outside, and its truth."""

    mask: Array
    depth: Array
    pixels: Array
    metres: Array
    hidden: Array


class Image(NamedTuple):
    """One frame: whose each pixel is, -1 for none; its depth, 0 where nothing returns; whether a hand covers it."""

    owner: Array
    depth: Array
    covered: Array


class Thing(Protocol):
    """An object that moves."""

    def layer(self, t: float, share: float, camera: Intrinsics) -> Layer:
        """Draw it at a time in seconds, which is a share 0...1 of the stream."""
        ...


@dataclass(frozen=True, kw_only=True)
class Motion:
    """How an object moves: metres, seconds, radians.

    Args:
        seed: Of its form.
        middle: Where it is at the beginning and at the end.
        travel: Where it goes from there in the middle of the stream.
        wander: The amplitude of its way about there.
        tempo: Of wandering and bending, radians a second.
        turn: About the optical axis, radians a second.
        sway: Radians by which it swings to and fro about the optical axis.
        angle: About the optical axis, at the beginning.
        tilt: About x and y.
        jump: An offset from the middle of the stream on: another object.
    """

    seed: int = 0
    middle: Triple = (0.0, 0.0, 0.7)
    travel: Triple = (0.0, 0.0, 0.0)
    wander: float = 0.03
    tempo: float = 2.0
    turn: float = 0.3
    sway: float = 0.0
    angle: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)
    jump: Triple = (0.0, 0.0, 0.0)

    def placed(self, points: Array, t: float, share: float) -> Array:
        """Turn points of the object's own frame, ``(..., 3)``, and move them to where it is."""
        (a, b), c = self.tilt, self.angle + self.turn * t + self.sway * np.sin(self.tempo * t)
        turned = points @ cv2.Rodrigues(np.array([0.0, 0.0, c]))[0].T
        turned = turned @ (cv2.Rodrigues(np.array([a, 0.0, 0.0]))[0] @ cv2.Rodrigues(np.array([0.0, b, 0.0]))[0]).T
        phase = np.random.default_rng(self.seed + 99).uniform(0, 2 * np.pi, 2)
        way = np.append(self.wander * np.sin(np.array([0.9, 0.7]) * self.tempo * t + phase), 0.0)
        gone = 1 - abs(2 * share - 1)
        return turned + self.middle + way + gone * np.array(self.travel) + (share > 0.5) * np.array(self.jump)


@dataclass(frozen=True, kw_only=True)
class Rope(Motion):
    """A rope, or a thick or tapering body.

    Args:
        length: In metres.
        radius: In metres.
        bend: How strongly it is bent.
        swing: By how much its bends change, radians of their phase.
        pitch: How far it leaves its plane, radians.
        loop: Turns of its heading in its middle part; from about 0.8 on it crosses itself.
        lift: Metres by which its end lies nearer than its beginning.
        taper: The radius of its end as a share of ``radius``, that of its beginning.
        pull: Share by which its length changes, as that of a band that is pulled.
        twist: Radians by which it turns to and fro about the line from its beginning to its end, and about the x axis.
        held: Its beginning stays where the middle would be, as that of a body that is fixed beyond the image's border.
    """

    length: float = 0.42
    radius: float = 0.006
    bend: float = 1.1
    swing: float = 0.7
    pitch: float = 0.0
    loop: float = 0.0
    lift: float = 0.0
    taper: float = 1.0
    pull: float = 0.0
    twist: float = 0.0
    held: bool = False

    def layer(self, t: float, share: float, camera: Intrinsics) -> Layer:
        """Draw it."""
        rng, s = np.random.default_rng(self.seed), np.linspace(0, 1, ROPE_POINTS)
        size, phase = rng.normal(size=3) / (1, 2, 3), rng.uniform(0, 2 * np.pi, (4, 2))
        yaw = 2 * np.pi * self.loop * (0.5 - 0.5 * np.cos(np.pi * np.clip((s - 0.2) / 0.6, 0, 1)))
        for k in range(3):
            swung = phase[k, 0] + self.swing * np.sin(self.tempo * t + phase[k, 1])
            yaw = yaw + self.bend * size[k] * np.sin(np.pi * (k + 1) * s + swung)
        pitch = self.pitch * np.sin(5 * s + self.tempo * t + phase[3, 0])
        step = np.stack([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)], axis=1)
        length = self.length * (1 + self.pull * np.sin(self.tempo * t + phase[3, 1]))
        axis = np.cumsum(step, axis=0) * length / (ROPE_POINTS - 1)
        axis = axis - (axis[0] if self.held else axis.mean(axis=0)) - np.outer(s - 0.5, (0, 0, self.lift))
        if self.twist:
            lengthwise = (axis[-1] - axis[0]) / np.linalg.norm(axis[-1] - axis[0])
            for way in (lengthwise, np.array([1.0, 0.0, 0.0])):
                axis = axis @ cv2.Rodrigues(way * self.twist * np.sin(self.tempo * t + phase[2, 1]))[0].T
        radius = self.radius * (1 - (1 - self.taper) * s)
        seen = see(self.placed(axis, t, share), radius, camera, 0.0)
        every = slice(None, None, 3)
        return Layer(seen.mask > 0, seen.depth, seen.pixels[every], seen.metres[every], ~seen.shown[every])


@dataclass(frozen=True, kw_only=True)
class Blob(Motion):
    """A flat blob with waves around it.

    Args:
        radius: In metres.
        waves: Their amplitudes as shares of the radius: two to a turn, three, ...
        swell: By how much they grow and shrink.
        hole: Its radius as a share; 0 for none.
        truth_hole: The truth is the outline of the hole.
    """

    radius: float = 0.13
    waves: tuple[float, ...] = (0.2, 0.1, 0.05)
    swell: float = 0.2
    hole: float = 0.0
    truth_hole: bool = False

    def layer(self, t: float, share: float, camera: Intrinsics) -> Layer:
        """Draw it."""
        phase = np.random.default_rng(self.seed).uniform(0, 2 * np.pi, (len(self.waves), 2))
        reach = np.ones(len(_OUTLINE))
        for k, (size, (at, pace)) in enumerate(zip(self.waves, phase, strict=True)):
            swollen = size * (1 + self.swell * np.sin(self.tempo * t + pace))
            reach += swollen * np.cos((k + 2) * _OUTLINE + at)
        flat = np.stack([np.cos(_OUTLINE), np.sin(_OUTLINE), np.zeros(len(_OUTLINE))], axis=1)
        outline = self.placed(flat * (self.radius * reach)[:, None], t, share)
        inner = self.placed(flat * (self.radius * self.hole * (0.4 + 0.6 * reach))[:, None], t, share)
        pixels, hole = camera.project(outline), camera.project(inner)
        mask = draw_blob(pixels, hole if self.hole else None, size=camera.size).mask > 0
        # The plane through the outline, on every pixel's ray.
        middle = outline.mean(axis=0)
        normal = np.linalg.svd(outline - middle, full_matrices=False)[2][2]
        depth = np.where(mask, (normal @ middle) / (_rays(camera) @ normal), 0.0)
        truth, true_pixels = (inner, hole) if self.truth_hole else (outline, pixels)
        return Layer(mask, depth, true_pixels[::2], truth[::2], _outside(true_pixels[::2], camera))


@dataclass(frozen=True, kw_only=True)
class Sheet(Motion):
    """A sheet that is bent about an axis in it and sheared.

    Args:
        width: Metres.
        height: Metres.
        roll: Turn from one side to the other by which it is bent.
        roll_axis: The direction of the axis in the sheet.
        shear: How far its sides lean and wave, metres.
    """

    width: float = 0.32
    height: float = 0.2
    roll: float = 0.0
    roll_axis: float = 0.4
    shear: float = 0.008

    def layer(self, t: float, share: float, camera: Intrinsics) -> Layer:
        """Draw it."""
        u, v = np.meshgrid(np.linspace(-0.5, 0.5, _SIDE), np.linspace(-0.5, 0.5, _SIDE))
        wave = self.shear * np.sin(self.tempo * t + self.seed)
        x, y = u * self.width + wave * np.cos(np.pi * v), v * self.height + self.shear * np.cos(np.pi * u)
        way = np.array([np.cos(self.roll_axis), np.sin(self.roll_axis)])
        along, across = x * way[0] + y * way[1], y * way[0] - x * way[1]
        curved = self.roll * (1 + 0.3 * np.sin(self.tempo * t)) / np.ptp(across) + 1e-9
        rolled, z = np.sin(curved * across) / curved, (1 - np.cos(curved * across)) / curved
        points = np.stack([along * way[0] - rolled * way[1], along * way[1] + rolled * way[0], z], axis=-1)
        points = self.placed(points, t, share)
        pixels = camera.project(points)
        mask = draw_sheet(pixels, size=camera.size).mask > 0
        depth, at = np.zeros(camera.size), np.argwhere(mask)
        if len(at):
            inside = LinearNDInterpolator(pixels.reshape(-1, 2), points[..., 2].ravel())(at[:, ::-1])
            depth[mask] = np.where(np.isfinite(inside), inside, np.nanmean(inside))
        flat = pixels.reshape(-1, 2)
        return Layer(mask, depth, flat, points.reshape(-1, 3), _outside(flat, camera))


@dataclass(frozen=True)
class Hand:
    """A disc that comes over a material point in the middle of the stream and goes again, or a bar that passes.

    Args:
        over: Index of the point in the truth of the first object; None for an upright bar that crosses the image.
        radius: Pixels; half the breadth of a bar.
        aside: Radians between the way on which it comes and the way from the object's middle to the point.
        depth: Metres from it to the object; 0 for what is cut out of the mask and has no depth of its own.
        stays: The share of the stream in which it is there.
    """

    over: int | None = 0
    radius: float = 16.0
    aside: float = 0.4
    depth: float = _HAND
    stays: float = 0.5

    def cover(self, layer: Layer, share: float, size: tuple[int, int]) -> Array:
        """Return ``(H, W)`` bool, which pixels it covers."""
        v, u = np.mgrid[: size[0], : size[1]]
        if self.over is None:
            at = -self.radius + (size[1] + 2 * self.radius) * share
            return np.abs(u - at) < self.radius
        away = np.clip(abs(2 * share - 1) - self.stays, 0, None) * 2 * (self.radius + 60)
        out = np.subtract(layer.pixels[self.over], layer.pixels.mean(axis=0))
        angle = np.arctan2(out[1], out[0]) + self.aside
        middle = layer.pixels[self.over] + away * np.array([np.cos(angle), np.sin(angle)])
        return (u - middle[0]) ** 2 + (v - middle[1]) ** 2 < self.radius**2


def camera_of(size: tuple[int, int] = (240, 320), **lens: Any) -> Intrinsics:
    """Return a camera with a horizontal field of view of 56 degrees for images of ``size`` ``(H, W)``."""
    focal = size[1] * 600 / 640
    return Intrinsics(size[1], size[0], focal, focal, (size[1] - 1) / 2, (size[0] - 1) / 2, **lens)


def draw(
    name: str,
    things: list[Thing],
    shapes: list[dict[str, Any]],
    *,
    arguments: dict[str, Any] | None = None,
    frames: int = 24,
    rate: float = 30.0,
    stamps: str = "even",
    skipped: tuple[int, ...] = (),
    pause: float = 0.0,
    gone: tuple[int, ...] = (),
    hands: tuple[Hand, ...] = (),
    depth: str = "",
    wall: float = 0.0,
    noise: float = 0.0,
    holes: float = 0.0,
    camera: Intrinsics | None = None,
    transform: Array | None = None,
    grips: dict[str, tuple[int, int]] | None = None,
    anchored: bool = False,
    clutter: float = 0.0,
    via: Literal["mask", "image", "cloud"] = "mask",
    colours: tuple[Triple, ...] = (),
    cloud: int = 900,
    tube: float = 0.0,
    size: tuple[int, int] = (180, 240),
) -> Stream:
    """Draw a stream.

    Args:
        name: Of the stream; also the seed of all noise.
        things: The objects; the truth belongs to the shape at the same place in ``shapes``, or else to the last.
        shapes: The configurations to look for.
        arguments: The detector's other arguments.
        frames: How many.
        rate: Frames a second.
        stamps: ``"even"``, ``"none"``, ``"jitter"``, or ``"stuck"``: some stand still, one runs back.
        skipped: Frames before which five were lost: the time goes on.
        pause: Seconds without a frame in the middle of the stream.
        gone: Frames without the objects.
        hands: What comes over the objects.
        depth: ``"mm"`` for uint16, ``"m"`` for float32, ``""`` for none.
        wall: Depth behind the objects, metres; 0 where nothing returns.
        noise: Disparity error of a stereo camera, pixels.
        holes: Share of the objects' area without depth.
        camera: Default a pinhole of ``size``.
        transform: From the camera to the base frame.
        grips: Names of anchors -> object and index of its point.
        anchored: The truth's point 0 is the detector's.
        clutter: Share of wrong pixels near the border of the mask, and a few specks.
        via: How the detector is given the frames.
        colours: RGB of each object; for pictures.
        cloud: How many points a cloud has.
        tube: Radius of a cloud around the truth of the first object, seen from all sides; 0 for what the camera sees.
        size: Of the images, ``(H, W)``.
    """
    rng, camera = np.random.default_rng(zlib.crc32(name.encode())), camera or camera_of(size)
    step = np.full(frames, 1.0) + (rng.uniform(-0.4, 0.4, frames) if stamps == "jitter" else 0.0)
    step[list(skipped)] += 5
    step[frames // 2] += pause * rate
    times = np.cumsum(step) / rate
    shown = {"none": np.full(frames, np.nan), "stuck": times.copy()}.get(stamps, times)
    if stamps == "stuck":
        shown[[5, 6]], shown[12] = shown[4], shown[9]
    in_space, clouds = bool(depth), via == "cloud"
    kept: dict[str, list[Array]] = {key: [] for key in ("masks", "depth", "rgb", "clouds")}
    layers: list[list[Layer]] = []
    for frame, t in enumerate(times):
        share = frame / max(frames - 1, 1)
        drawn = [thing.layer(float(t), share, camera) for thing in things]
        covers = [(hand, hand.cover(drawn[0], share, camera.size)) for hand in hands]
        drawn, image = _empty(drawn) if frame in gone else _composed(drawn, covers)
        layers.append(drawn)
        mask = image.owner >= 0
        near = cv2.dilate((mask | image.covered).astype(np.uint8), np.ones((_KEPT, _KEPT), np.uint8)) > 0
        metres = np.where((image.depth == 0) & ~image.covered, wall, image.depth)
        metres = _measured(rng, metres, near, camera, noise, holes)
        kept["depth"].append(np.rint(metres * 1e3).astype(np.uint16) if depth == "mm" else metres.astype(np.float32))
        kept["masks"].append(_cluttered(rng, mask, clutter))
        if colours:
            kept["rgb"].append(_pictured(rng, image, near, colours))
        if clouds:
            points = _tube(rng, drawn[0], tube) if tube else _front(metres, mask, camera)
            kept["clouds"].append(_chosen(rng, points, cloud))
    model, truth, anchors = CameraModel(camera, transform), [], {}
    for k in range(len(things)):
        pixels, metres, hidden = (np.stack([getattr(frame[k], key) for frame in layers]) for key in Layer._fields[2:])
        for key, (_, point) in filter(lambda grip: grip[1][0] == k, (grips or {}).items()):
            anchors[key] = pixels[:, point] if transform is None else model.to_base(metres[:, point])
        # What the detector cannot know is not stored.
        pixels, metres = pixels * (np.nan if clouds else 1), metres * (1 if in_space or tube else np.nan)
        spec = shapes[min(k, len(shapes) - 1)]
        truth.append(Truth(spec.get("name", spec["kind"]), pixels, metres, hidden))
    given = {key: np.stack(each) for key, each in kept.items() if each}
    return Stream(
        name,
        {"shapes": shapes, **(arguments or {})},
        shown,
        given["masks"] if via == "mask" else None,
        given["depth"] if in_space and not clouds else None,
        given.get("rgb"),
        given.get("clouds"),
        model if (in_space and not clouds) or transform is not None else None,
        anchors,
        tuple(truth),
        anchored,
    )


def _empty(drawn: list[Layer]) -> tuple[list[Layer], Image]:
    """Return a frame without the objects."""
    size = drawn[0].mask.shape
    gone = [each._replace(pixels=each.pixels * np.nan, metres=each.metres * np.nan) for each in drawn]
    return gone, Image(np.full(size, -1), np.zeros(size), np.zeros(size, bool))


def _composed(drawn: list[Layer], covers: list[tuple[Hand, Array]]) -> tuple[list[Layer], Image]:
    """Lay objects over each other and hands over all of them; return the objects with what is hidden, and the image."""
    depths = np.stack([np.where(each.mask, each.depth, np.inf) for each in drawn])
    owner, depth = np.where(np.isfinite(depths).any(axis=0), depths.argmin(axis=0), -1), depths.min(axis=0)
    nearest, covered = min(float(depth.min()), 1.0), np.zeros(depth.shape, bool)
    depth = np.where(owner >= 0, depth, 0.0)
    for hand, cover in covers:
        covered |= cover
        depth[cover] = nearest - hand.depth if hand.depth else 0.0
    owner[covered] = -1
    for k, each in enumerate(drawn):
        u, v = np.rint(np.where(each.hidden[:, None], 0, each.pixels)).astype(int).T
        u, v = u.clip(0, owner.shape[1] - 1), v.clip(0, owner.shape[0] - 1)  # of an outline on the border
        under = covered[v, u] | ((owner[v, u] != k) & (owner[v, u] != -1))
        drawn[k] = each._replace(hidden=each.hidden | under)
    return drawn, Image(owner, depth, covered)


def _measured(
    rng: np.random.Generator, depth: Array, near: Array, camera: Intrinsics, noise: float, holes: float
) -> Array:
    """Return depth as a stereo camera with a baseline of 95 mm measures it, where anything is near."""
    if noise:
        blurred = cv2.GaussianBlur(rng.normal(size=depth.shape), (0, 0), 1.0)
        depth = depth + depth**2 * noise / (camera.fx * 0.095) * blurred / blurred.std() * (depth > 0)
    if holes:
        blurred = cv2.GaussianBlur(rng.normal(size=depth.shape), (0, 0), 3.0)
        depth = np.where(blurred > np.quantile(blurred, 1 - holes), 0.0, depth)
    return np.round(np.where(near | (noise == 0), depth, 0.0), 4)


def _cluttered(rng: np.random.Generator, mask: Array, share: float) -> Array:
    """Return a mask with wrong pixels along its border and a few specks."""
    if not share:
        return mask
    border = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0
    out = mask ^ (border & (rng.random(mask.shape) < share))
    for v, u in rng.integers(0, (mask.shape[0] - 3, mask.shape[1] - 3), (6, 2)):
        out[v : v + 3, u : u + 2] = True
    return out


def _pictured(rng: np.random.Generator, image: Image, near: Array, colours: tuple[Triple, ...]) -> Array:
    """Return a picture ``(H, W, 3)``: coloured objects and brown hands on a gray table, with light from the left."""
    owner = image.owner
    light = np.linspace(1.1, 0.8, 8).repeat(-(-owner.shape[1] // 8))[: owner.shape[1], None]
    picture = np.full((*owner.shape, 3), 150.0)
    for k, colour in enumerate(colours):
        picture[owner == k] = colour
    picture[image.covered] = (190, 140, 110)
    picture = cv2.GaussianBlur(picture * light, (0, 0), 0.7)
    noise = np.round(rng.normal(0, 4, picture.shape) / 4) * 4 * near[..., None]
    return np.clip(np.rint(picture + noise), 0, 255).astype(np.uint8)


def _front(depth: Array, mask: Array, camera: Intrinsics) -> Array:
    """Return the points of the objects that the camera sees, ``(M, 3)``."""
    v, u = np.nonzero(mask & (depth > 0))
    return camera.deproject(np.stack([u, v], axis=1), depth[v, u])


def _tube(rng: np.random.Generator, layer: Layer, radius: float) -> Array:
    """Return points around a curve, ``(4000, 3)``: on balls about points of it."""
    at, way = rng.uniform(0, len(layer.metres) - 1, 4000), rng.normal(size=(4000, 3))
    line = [np.interp(at, np.arange(len(layer.metres)), column) for column in layer.metres.T]
    return np.stack(line, axis=1) + radius * way / np.linalg.norm(way, axis=1, keepdims=True)


def _chosen(rng: np.random.Generator, points: Array, count: int) -> Array:
    """Return ``(count, 3)`` of the points at random, zeros where there are fewer."""
    out, points = np.zeros((count, 3)), rng.permutation(points)[:count]
    out[: len(points)] = points
    return out


def _rays(camera: Intrinsics) -> Array:
    return camera.rays(np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1))


def _outside(pixels: Array, camera: Intrinsics) -> Array:
    beyond = (pixels < -0.5) | (pixels > (camera.width - 0.5, camera.height - 0.5))
    return np.any(beyond, axis=1)
