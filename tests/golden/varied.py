"""Streams that a table draws: every body, motion, frame rate, gap, camera and question, in pairs that nobody chose.

Each column of the table is shuffled by itself, so that a level meets others by chance and occurs as often as the rest
of its column. What cannot be combined is put right in ``_stream``: points in metres need depth, for instance.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Final

import numpy as np

from tests.golden.scenes import Blob, Hand, Rope, Sheet, Thing, camera_of, draw
from tests.golden.streams import Stream

_COUNT: Final = 64
_SEED: Final = 20
_TURN_A_FRAME: Final = 0.35  # radians of a motion's phase from one frame to the next, at most
_FRAMES: Final = {10: 16, 30: 20, 60: 24, 240: 36}  # by hertz
_AT_BORDER: Final = -0.281  # metres: there a body is fixed that hangs into an image whose border is at -0.278
_SMALL, _LARGE = (120, 160), (180, 240)  # rows and columns

_BODIES: Final[dict[str, tuple[type, dict[str, Any]]]] = {
    "cord": (Rope, {"radius": 0.004}),
    "rope": (Rope, {"radius": 0.008}),
    "thick": (Rope, {"radius": 0.028, "bend": 0.5}),
    "tapering": (Rope, {"radius": 0.02, "taper": 0.35, "bend": 0.8}),
    "hanging": (Rope, {"radius": 0.006, "held": True, "bend": 0.7}),
    "beam": (Rope, {"radius": 0.032, "taper": 0.6, "held": True, "bend": 0.35}),
    "outline": (Blob, {}),
    "band": (Blob, {"hole": 0.75}),
    "sheet": (Sheet, {}),
    "cloth": (Sheet, {"width": 0.26, "height": 0.24, "roll": 1.0, "tilt": (0.25, 0.15)}),
    "two ropes": (Rope, {"length": 0.34, "bend": 0.5}),
}
_MOTIONS: Final[dict[str, dict[str, Any]]] = {
    "rests": {"wander": 0.0, "turn": 0.0, "swing": 0.0, "swell": 0.0, "shear": 0.0},
    "wanders": {"wander": 0.05, "turn": 0.4},
    "swings": {"sway": 0.45, "turn": 0.0, "swing": 1.2},
    "twists": {"twist": 0.6, "turn": 0.1, "tilt": (0.5, 0.2)},
    "is pulled": {"pull": 0.02, "swing": 0.2, "swell": 0.05, "shear": 0.015},
    "slides out": {"travel": (0.2, 0.05, 0.0)},
    "comes nearer": {"travel": (0.02, 0.0, -0.2)},
}
_RATES: Final = (10, 30, 60, 240)  # hertz
_PACES: Final = (1.5, 4.0, 9.0, 14.0)  # radians of a motion's phase a second
_TIMES: Final[tuple[dict[str, Any], ...]] = (
    {}, {"stamps": "jitter"}, {"skipped": (6, 13)}, {"pause": 0.1}, {"pause": 0.5}, {"pause": 2.0},
)  # fmt: skip
_DEPTHS: Final[tuple[dict[str, Any], ...]] = (
    {}, {"depth": "mm", "wall": 0.9}, {"depth": "mm", "noise": 0.08}, {"depth": "mm", "holes": 0.1}, {}, {"depth": "m"},
)  # fmt: skip
_COVERS: Final[dict[str, dict[str, Any] | None]] = {
    "": None,
    "a hand": {"over": 0.9, "radius": 15.0},
    "nothing ": None,
    "a hole": {"over": 0.1, "radius": 12.0, "depth": 0.0},
    "nothing": None,
    "a bar": {"over": None, "radius": 9.0},
    "a hand in the middle": {"over": 0.5, "radius": 11.0},
}
_CAMERAS: Final[tuple[dict[str, Any], ...]] = (
    {},
    {"model": "brown_conrady", "coeffs": (-0.2, 0.06, 0.001, -0.0008, -0.01)},
    {},
    {"model": "inverse_brown_conrady", "coeffs": (-0.05, 0.06, -0.0005, 0.0007, -0.02)},
    {},
)
_SIZES: Final = (_SMALL, _LARGE, _SMALL)
_ASKED: Final[tuple[dict[str, Any], ...]] = (
    {}, {"spacing": "m"}, {"ends": "tips"}, {}, {"order": "image"}, {"lift": "cloud"}, {"radius": 0.006},
    {"fewer": True},
)  # fmt: skip
# Rows in which the last digit decides: between two numberings with another version of NumPy (19, 48), and on another
# processor about 0.1 to 0.3 mm of single points (the others), more than a stream may differ by.
_LEFT_OUT: Final = {1, 19, 31, 48, 57, 60}
_KINDS: Final = {Rope: "centerline", Blob: "contour", Sheet: "surface"}


def table() -> dict[str, Callable[[], Stream]]:
    """Return the streams by name."""
    rng = np.random.default_rng(_SEED)
    columns = [
        _shuffled(rng, levels)
        for levels in (_BODIES, _MOTIONS, _RATES, _PACES, _TIMES, _DEPTHS, _COVERS, _CAMERAS, _SIZES, _ASKED)
    ]
    rows = enumerate(zip(*columns, strict=True))
    named = {f"varied_{k:02}_{row[0]}_{row[2]}hz".replace(" ", "_"): (k, row) for k, row in rows if k not in _LEFT_OUT}
    return {name: partial(_stream, name, *given) for name, given in named.items()}


def _shuffled(rng: np.random.Generator, levels: Any) -> list[Any]:
    """Return each level as often as the others, in any order, once for each stream."""
    levels = list(levels)
    return [levels[k % len(levels)] for k in rng.permutation(_COUNT)]


def _stream(name: str, number: int, row: tuple[Any, ...]) -> Stream:
    body, motion, rate, pace, time, depth, cover, lens, size, asked = row
    kind, form = _BODIES[body]
    moved = {key: value for key, value in _MOTIONS[motion].items() if key in kind.__dataclass_fields__}
    common = {"seed": 700 + number, "tempo": min(pace, _TURN_A_FRAME * rate), **moved, **form}
    if form.get("held"):
        common |= {"middle": (0.0, _AT_BORDER, 0.7), "angle": np.pi / 2, "turn": 0.0, "wander": 0.0}
    things: list[Thing] = [kind(**common)]
    if body == "two ropes":
        things.append(Rope(**common | {"seed": 800 + number, "angle": 1.4, "middle": (0.0, 0.0, 0.67)}))
    shape = {"kind": _KINDS[kind]} | {key: value for key, value in asked.items() if key != "fewer"}
    if kind is not Rope:
        shape.pop("ends", None)
    fewer, many = asked.get("fewer", False), len(things) > 1
    shape |= {"rows": 3 + 2 * fewer, "cols": 5} if kind is Sheet else {"n": 9 if fewer else 20}
    if many:
        shape = {key: value for key, value in shape.items() if key != "lift"} | {"count": 2}
    if body == "band":
        shape["ring"] = True
    in_space = {"spacing", "lift", "radius"} & set(asked)
    if (in_space or lens) and not depth:
        depth = {"depth": "mm"}
    hands = ()
    if (hider := _COVERS[cover]) is not None:
        points = {Rope: 61, Blob: 180, Sheet: 169}[kind]
        over = hider["over"] if hider["over"] is None else int(hider["over"] * (points - 1))
        wide = hider["radius"] * size[1] / 240
        hands = (Hand(over, wide, depth=hider.get("depth", 0.08) if depth else 0.0),)
    more: dict[str, Any] = {**time, **depth, "rate": rate, "frames": _FRAMES[rate], "size": size}
    return draw(name, things, [shape], hands=hands, camera=camera_of(size, **lens), **more)
