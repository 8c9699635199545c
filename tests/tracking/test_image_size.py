"""An image that is cropped or resized shows the same object: no decision changes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pytest

from tests.golden.streams import Stream, load_stream, play

Array = npt.NDArray[Any]

LEFT, TOP, RIGHT, BOTTOM = 40, 24, 56, 40  # pixels that are added around an image; the masks touch no border
STREAMS: Final = (
    "rope_calm", "rope_depth_mm", "rope_hand_on_end", "rope_middle_cut", "rope_hands_on_both", "rope_bar_passes",
    "rope_lens", "blob_turning", "blob_hand", "blob_cut", "sheet_calm", "sheet_bent", "sheet_corner_hidden",
    "ropes_apart", "varied_20_rope_10hz", "varied_40_rope_30hz", "varied_17_tapering_60hz", "varied_42_sheet_240hz",
)  # fmt: skip


def shown(stream: Stream, images: Any, **camera: float) -> Stream:
    """Return a stream whose images are changed, and its camera with them."""
    if stream.camera is not None:
        lens = replace(stream.camera.intrinsics, **camera)
        stream = replace(stream, camera=replace(stream.camera, intrinsics=lens))
    changed = {name: getattr(stream, name) for name in ("masks", "depth", "rgb")}
    return replace(stream, **{name: images(each) for name, each in changed.items() if each is not None})


@pytest.mark.parametrize("name", STREAMS)
def test_what_is_cropped_away_around_an_object_decides_nothing(name: str):
    stream = load_stream(name)
    lens = None if stream.camera is None else stream.camera.intrinsics
    size = {} if lens is None else {
        "width": lens.width + LEFT + RIGHT, "height": lens.height + TOP + BOTTOM, "cx": lens.cx + LEFT,
        "cy": lens.cy + TOP,
    }  # fmt: skip
    around = [(0, 0), (TOP, BOTTOM), (LEFT, RIGHT)]
    larger = shown(stream, lambda each: np.pad(each, around + [(0, 0)] * (each.ndim - 3)), **size)
    (small, _), (large, _) = play(stream), play(larger)
    np.testing.assert_array_equal(large.ok, small.ok)
    np.testing.assert_array_equal(large.visible, small.visible)
    away = np.linalg.norm(large.points2d - (LEFT, TOP) - small.points2d, axis=-1)[small.visible]
    assert np.median(away) < 0.3
    assert away.max() < 2


@pytest.mark.parametrize("name", STREAMS)
def test_an_image_of_twice_the_size_decides_nothing(name: str):
    """The staircase of a mask's border is as large as two pixels, so single points may differ, and one frame."""
    stream = load_stream(name)
    lens = None if stream.camera is None else stream.camera.intrinsics
    size = {} if lens is None else {
        "width": 2 * lens.width, "height": 2 * lens.height, "fx": 2 * lens.fx, "fy": 2 * lens.fy,
        "cx": 2 * lens.cx + 0.5, "cy": 2 * lens.cy + 0.5,
    }  # fmt: skip
    (small, _), (large, _) = play(stream), play(shown(stream, lambda each: each.repeat(2, 1).repeat(2, 2), **size))
    assert np.mean(large.ok != small.ok) < 0.04
    assert np.mean((large.visible != small.visible)[large.ok & small.ok]) < 0.03
    both = small.visible & large.visible
    assert np.median(np.linalg.norm((large.points2d - 0.5) / 2 - small.points2d, axis=-1)[both]) < 1.5
