"""The streams: what moves, how it is seen, and what the detector is asked for."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Final

import numpy as np

from tests.golden import varied
from tests.golden.scenes import Blob, Hand, Rope, Sheet, Thing, camera_of, draw
from tests.golden.streams import Stream

STREAMS: Final[dict[str, Callable[[], Stream]]] = varied.table()
_ABOVE: Final = np.array([[1.0, 0, 0, 0.3], [0, -1, 0, 0.1], [0, 0, -1, 0.9], [0, 0, 0, 1]])
_HSV: Final = {"kind": "hsv", "low": [90, 60, 30], "high": [130, 255, 255]}
_BLUE, _RED, _GREEN = (35.0, 60.0, 190.0), (200.0, 50.0, 40.0), (40.0, 160.0, 60.0)
_SMALL: Final = (120, 160)
_START, _MIDDLE, _END = 0, 30, 60  # indices in the truth of a rope


def _stream(name: str, things: Thing | list[Thing], *shapes: dict[str, Any], **options: Any) -> None:
    things = things if isinstance(things, list) else [things]
    STREAMS[name] = partial(draw, name, things, list(shapes), **options)


def _line(n: int = 20, **more: Any) -> dict[str, Any]:
    return {"kind": "centerline", "n": n, **more}


def _ring(n: int = 32, **more: Any) -> dict[str, Any]:
    return {"kind": "contour", "n": n, **more}


def _grid(rows: int = 4, cols: int = 8, **more: Any) -> dict[str, Any]:
    return {"kind": "surface", "rows": rows, "cols": cols, **more}


# Ropes in a mask.
_stream("rope_calm", Rope(seed=1), _line())
_stream("rope_fast", Rope(seed=2, tempo=7, wander=0.08, turn=1.5, length=0.3), _line())
_stream("rope_10hz_jitter", Rope(seed=3), _line(16), rate=10, stamps="jitter")
_stream("rope_90hz", Rope(seed=4, tempo=9, turn=1.0), _line(), rate=90, frames=30)
_stream("rope_no_stamps", Rope(seed=5), _line(), rate=15, stamps="none", arguments={"dt": 1 / 15})
_stream("rope_stuck_stamps", Rope(seed=6), _line(), stamps="stuck", arguments={"on_missing": "truncate"})
_stream("rope_frames_lost", Rope(seed=7, tempo=3), _line(), skipped=(8, 14))
_stream("rope_thin", Rope(seed=208, radius=0.002), _line(24))
_stream("rope_thick_tips", Rope(seed=9, radius=0.022, bend=0.6), _line(12), arguments={"ends": "tips"})
_stream("rope_stout", Rope(seed=10, radius=0.03, length=0.25, bend=0.3), _line(6))
_stream("rope_tapering", Rope(seed=11, tilt=(0.9, 0.0), middle=(0, 0, 0.55), angle=1.2, turn=0.1), _line())
_stream("rope_image_order", Rope(seed=12, turn=2.5), _line(), arguments={"order": "image"})
_stream("rope_many_points", Rope(seed=213, length=0.5), _line(64, ends="tips"), size=(240, 320))
_stream("rope_two_points", Rope(seed=14), _line(2), size=_SMALL)
_stream("rope_hairpin", Rope(seed=15, loop=0.5, bend=0.15, length=0.5), _line())
_stream("rope_loop_in_mask", Rope(seed=16, loop=0.95, bend=0.3, length=0.6), _line(24))
_stream("rope_clutter", Rope(seed=617), _line(), clutter=0.2)
_stream("rope_roi", Rope(seed=18, length=0.3), _line(),
        arguments={"roi": {"kind": "rectangle", "left": 30, "top": 20, "width": 190, "height": 140}})  # fmt: skip
_stream("rope_border", Rope(seed=19, travel=(0.22, 0.0, 0.0)), _line(), frames=36)
_stream("rope_enters", Rope(seed=20, middle=(-0.3, 0.1, 0.7), travel=(0.32, -0.1, 0.0)), _line(), frames=36)
_stream("rope_corner", Rope(seed=21, travel=(0.15, 0.15, 0.0)), _line(), frames=36, rate=15)
_stream("rope_end_cut", Rope(seed=22), _line(), hands=(Hand(_END, 20, depth=0),), frames=36)
_stream("rope_middle_cut", Rope(seed=23), _line(), hands=(Hand(_MIDDLE, 14, depth=0),), frames=36)
_stream("rope_both_ends_cut", Rope(seed=24, tempo=4), _line(), frames=36,
        hands=(Hand(_START, 12, -0.6, depth=0), Hand(_END, 14, depth=0)))  # fmt: skip
_stream("rope_bar_passes", Rope(seed=25), _line(), hands=(Hand(None, 15, depth=0),), rate=20, frames=30)
_stream("rope_lost_briefly", Rope(seed=26), _line(), gone=tuple(range(8, 14)))
_stream("rope_lost_long", Rope(seed=27), _line(), gone=tuple(range(6, 16)), rate=10, arguments={"on_missing": "nan"})
_stream("rope_lost_raises", Rope(seed=28), _line(), gone=(0, 1, 9, 10), arguments={"on_missing": "raise"})
_stream("rope_replaced", Rope(seed=29, length=0.3, jump=(0.12, 0.09, 0.0)), _line(), rate=15, frames=30,
        arguments={"max_speed": 1.0, "max_age": 0.3})  # fmt: skip
_stream("rope_pixel_anchor", Rope(seed=30), _line(anchor=[5.0, 170.0]))
_stream("rope_held", Rope(seed=31, turn=1.5), _line(anchor="hand"), grips={"hand": (0, _START)}, anchored=True)

# Ropes with depth.
_stream("rope_depth_mm", Rope(seed=40), _line(), depth="mm", wall=0.75)
_stream("rope_depth_noisy", Rope(seed=41), _line(), depth="m", noise=0.08, holes=0.02)
_stream("rope_depth_holes", Rope(seed=343), _line(), depth="mm", noise=0.08, holes=0.25,
        arguments={"on_invalid": "interpolate"})  # fmt: skip
_stream("rope_depth_holes_held", Rope(seed=43), _line(), depth="m", holes=0.3, arguments={"on_invalid": "hold"})
_stream("rope_in_metres", Rope(seed=44, tilt=(0.8, 0.2)), _line(spacing="m"), depth="m", wall=1.2)
_stream("rope_swung", Rope(seed=45, pitch=0.9, tempo=5, wander=0.06), _line(spacing="m", ends="tips"), depth="m")
_stream("rope_towards_camera", Rope(seed=46, pitch=1.4, length=0.35), _line(), depth="m", noise=0.05)
_stream("rope_hand_on_end", Rope(seed=47), _line(), hands=(Hand(_END, 18),), depth="mm", wall=0.72, frames=36,
        arguments={"on_invalid": "interpolate"})  # fmt: skip
_stream("rope_hand_on_middle", Rope(seed=350, tempo=3), _line(), hands=(Hand(_MIDDLE, 16),), depth="m", noise=0.08,
        frames=36)  # fmt: skip
_stream("rope_hands_on_both", Rope(seed=49, turn=0.8), _line(), hands=(Hand(_START, 12, -0.8), Hand(_END, 12)),
        depth="mm", noise=0.05, frames=36, rate=20)  # fmt: skip
_stream("rope_under_shadow", Rope(seed=50), _line(), hands=(Hand(45, 14, depth=0),), depth="mm", wall=0.73, frames=30)
_stream("rope_border_in_space", Rope(seed=51, pitch=0.5, travel=(-0.34, 0.05, 0.1)), _line(spacing="m"), depth="m",
        noise=0.05, frames=36)  # fmt: skip
_stream("rope_known_length", Rope(seed=52, radius=0.008), _line(length=0.42, radius=0.008), depth="mm",
        hands=(Hand(_START, 20),), frames=30, arguments={"on_invalid": "interpolate"})  # fmt: skip
_stream("rope_over_itself", Rope(seed=53, loop=0.95, lift=0.06, bend=0.3, length=0.6), _line(24), depth="mm",
        noise=0.04, wall=0.8)  # fmt: skip
_stream("rope_lens", Rope(seed=54, wander=0.1), _line(spacing="m"), depth="m", camera=camera_of(
    (180, 240), model="brown_conrady", coeffs=(-0.28, 0.09, 0.001, -0.0008, -0.01)))  # fmt: skip
_stream("rope_lens_inverse", Rope(seed=255, wander=0.1), _line(radius=0.006), depth="mm", camera=camera_of(
    (180, 240), model="inverse_brown_conrady", coeffs=(-0.05, 0.06, -0.0005, 0.0007, -0.02)))  # fmt: skip
_stream("rope_base_anchor", Rope(seed=56, turn=1.5), _line(anchor="gripper"), depth="m", transform=_ABOVE,
        grips={"gripper": (0, _START)}, anchored=True, noise=0.05)  # fmt: skip
_stream("rope_fit_in_space", Rope(seed=57, pitch=0.6), _line(lift="cloud"), depth="m", noise=0.06)
_stream("rope_fit_in_space_hand", Rope(seed=58, tempo=3), _line(lift="cloud"), depth="mm", hands=(Hand(_END, 14),),
        frames=30)  # fmt: skip
_stream("rope_by_depth", Rope(seed=359), _line(segmentation={"kind": "depth", "near": 0.5, "far": 0.72}), via="image",
        depth="mm", wall=0.8, noise=0.05)  # fmt: skip

# Several ropes.
_APART = [Rope(seed=60 + k, length=0.3, middle=(0, y, 0.7), turn=0.1, bend=0.5) for k, y in enumerate((-0.13, 0, 0.13))]
_stream("ropes_apart", list(_APART), _line(16, count=3))
_stream("ropes_crossing", [Rope(seed=64, bend=0.4, middle=(0, 0, 0.7), turn=0.6),
        Rope(seed=65, bend=0.4, angle=1.5, middle=(0, 0, 0.67), turn=-0.6)], _line(16, count=2), depth="mm",
        wall=0.72)  # fmt: skip
_stream("ropes_crossing_in_mask", [Rope(seed=66, bend=0.3, travel=(0, 0.1, 0), turn=0.0),
        Rope(seed=67, bend=0.3, angle=1.3, turn=0.0)], _line(12, count=2))  # fmt: skip
_stream("ropes_all", [_APART[0], Rope(seed=68, length=0.3, middle=(0.35, 0.1, 0.7), travel=(-0.35, 0, 0))],
        _line(10, count="all"), frames=36)  # fmt: skip
_stream("ropes_held", [Rope(seed=69, length=0.3, middle=(-0.03, -0.09, 0.7)), Rope(seed=70, length=0.3, angle=2.0,
        middle=(0.03, 0.1, 0.7))], _line(12, count=2, anchor={"centerline0": "a", "centerline1": "b"}), depth="m",
        transform=_ABOVE, grips={"a": (0, _START), "b": (1, _START)}, anchored=True)  # fmt: skip
_stream("ropes_hand", list(_APART), _line(12, count=3), hands=(Hand(_END, 22),), depth="mm", wall=0.72, frames=30)
_stream("ropes_coloured", [Rope(seed=71, bend=0.3, middle=(0, 0, 0.7)), Rope(seed=72, bend=0.3, angle=1.4,
        middle=(0, 0, 0.68))], _line(12, count=2), colours=(_BLUE, _GREEN), size=_SMALL, frames=16)  # fmt: skip

# Outlines.
_stream("blob_turning", Blob(seed=80, turn=2.0), _ring())
_stream("blob_swelling_10hz", Blob(seed=81, swell=0.4, tempo=4), _ring(24), rate=10)
_stream("blob_tilted_noisy", Blob(seed=383, tilt=(0.6, -0.3)), _ring(spacing="m"), depth="m", noise=0.02,
        frames=14)  # fmt: skip
_stream("blob_hole", Blob(seed=83, hole=0.5, truth_hole=True), _ring(20, hole=0), clutter=0.1)
_stream("blob_border", Blob(seed=84, travel=(0.3, 0.0, 0.0)), _ring(), frames=30)
_stream("blob_hand", Blob(seed=85, turn=0.8), _ring(), depth="mm", hands=(Hand(40, 22),), frames=36, wall=0.71)
_stream("blob_cut", Blob(seed=86), _ring(), hands=(Hand(90, 18, depth=0),), frames=30)
_stream("blob_star_image_order", Blob(seed=87, waves=(0.0, 0.05, 0.02, 0.3)), _ring(48), arguments={"order": "image"})
_stream("band_hand", Blob(seed=88, hole=0.75, turn=0.6), _ring(ring=True), hands=(Hand(20, 14, depth=0),), frames=30)
_stream("blob_fit_in_space", Blob(seed=89, tilt=(0.4, 0.5)), _ring(24, lift="cloud"), depth="mm", noise=0.04,
        size=_SMALL, frames=14)  # fmt: skip
_stream("blob_lost", Blob(seed=90, turn=1.5), _ring(), gone=(7, 8, 9), rate=60)

# Sheets.
_stream("sheet_calm", Sheet(seed=100), _grid())
_stream(
    "sheet_square_turning", Sheet(seed=101, width=0.24, height=0.24, turn=2.0), _grid(5, 5), arguments={"ends": "tips"}
)
_stream("sheet_bent", Sheet(seed=403, roll=1.2, tilt=(0.3, 0.2)), _grid(spacing="m"), depth="m", noise=0.02,
        frames=12)  # fmt: skip
_stream("sheet_corner_hidden", Sheet(seed=103), _grid(), hands=(Hand(0, 20),), depth="mm", wall=0.75, frames=30,
        arguments={"on_invalid": "interpolate"})  # fmt: skip
_stream("sheet_corner_cut", Sheet(seed=104, turn=0.5), _grid(), hands=(Hand(12, 16, depth=0),), frames=30)
_stream("sheet_inside_hidden", Sheet(seed=105), _grid(ends="tips"), hands=(Hand(84, 20, -0.8),), depth="mm", frames=30)
_stream("sheet_epochs", Sheet(seed=106, shear=0.02), _grid(3, 6, epochs=2), rate=15)
_stream("sheet_border", Sheet(seed=107, travel=(-0.27, 0.05, 0.0)), _grid(), frames=30)
_stream("sheet_tilted", Sheet(seed=411, tilt=(0.7, 0.3)), _grid(4, 6), depth="mm", noise=0.02, holes=0.05,
        frames=14)  # fmt: skip
_stream("sheet_image_order", Sheet(seed=109, turn=2.5), _grid(), arguments={"order": "image"})
_stream(
    "sheet_fit_in_space",
    Sheet(seed=110, roll=0.8),
    _grid(lift="cloud", freedom=0.5),
    depth="mm",
    size=_SMALL,
    frames=12,
)
_stream("sheet_held", Sheet(seed=111, turn=1.0), _grid(anchor="grip"), depth="m", transform=_ABOVE,
        grips={"grip": (0, 0)}, anchored=True)  # fmt: skip

# Clusterers.
_stream("rope_kmeans", Rope(seed=120), _line(10), arguments={"clustering": {"kind": "kmeans"}}, frames=10, size=_SMALL)
_stream("rope_gmm", Rope(seed=121), _line(8), arguments={"clustering": {"kind": "gmm"}}, frames=5, size=_SMALL)
_stream("rope_fcm", Rope(seed=122), _line(10), arguments={"clustering": {"kind": "fcm"}}, frames=10, size=_SMALL)
_stream(
    "blob_kohonen", Blob(seed=123), _ring(16), arguments={"clustering": {"kind": "kohonen"}}, frames=10, size=_SMALL
)
_stream("sheet_kmeans", Sheet(seed=124), _grid(3, 5), arguments={"clustering": {"kind": "kmeans"}}, frames=10,
        size=_SMALL)  # fmt: skip

# Clouds.
_stream("cloud_rope", Rope(seed=130, pitch=0.8), _line(), via="cloud", tube=0.005, size=_SMALL,
        frames=16)  # fmt: skip
_stream(
    "cloud_rope_front", Rope(seed=131, tilt=(0.5, 0.0), tempo=4), _line(ends="tips"), via="cloud", depth="m", noise=0.05
)
_stream("cloud_rope_gap", Rope(seed=132), _line(12), via="cloud", hands=(Hand(_MIDDLE, 10),), gone=(9, 10), depth="m")
_stream("cloud_ring", Blob(seed=133, tilt=(0.3, 0.3)), _ring(24), via="cloud", tube=0.005, size=_SMALL, frames=16)
_stream("cloud_sheet", Sheet(seed=134, roll=1.0), _grid(), via="cloud", cloud=2000, depth="m", frames=10)
_stream("cloud_held", Rope(seed=135, turn=1.5), _line(anchor="tip"), via="cloud", transform=_ABOVE,
        grips={"tip": (0, _START)}, anchored=True, depth="m")  # fmt: skip

# Pictures.
_stream("image_rope", Rope(seed=140), _line(), via="image", colours=(_BLUE,), arguments={"segmentation": _HSV},
        size=_SMALL, frames=16)  # fmt: skip
_stream("image_rope_hand", Rope(seed=141), _line(), via="image", colours=(_BLUE,), arguments={"segmentation": _HSV},
        size=_SMALL, hands=(Hand(_END, 12),), depth="mm", noise=0.05, frames=24)  # fmt: skip
_stream("image_two_shapes", [Rope(seed=142, length=0.3, middle=(0, -0.14, 0.7), bend=0.3, turn=0.1),
        Sheet(seed=143, middle=(0, 0.07, 0.72), width=0.3, height=0.16, turn=0.1)],
        _line(12, name="rope", segmentation=_HSV),
        _grid(3, 5, name="cloth", segmentation={"kind": "hsv", "low": [170, 90, 40], "high": [10, 255, 255]}),
        via="image", colours=(_BLUE, _RED), depth="mm", size=_SMALL, frames=12)  # fmt: skip
_stream("image_gray", Blob(seed=144, radius=0.1), _ring(20), via="image", colours=((30.0, 30.0, 30.0),),
        arguments={"segmentation": {"kind": "gray", "low": 0, "high": 80}}, size=_SMALL, frames=12)  # fmt: skip
