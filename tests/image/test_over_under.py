"""Which strand is above where two cross, by depth and by the picture, against drawn scenes."""

from __future__ import annotations

import numpy as np
import pytest

from shape_obs.frame import depth_images
from shape_obs.geometry.crossings import Crossing
from shape_obs.geometry.intersections import find_crossings
from shape_obs.image.over_under import find_layers
from tests.benchmarks.scenes.several_ropes import RopeScene, noisy_depth, several_ropes

_NONE = depth_images(None)


def judged(scene: RopeScene, depth, rgb) -> list[tuple[Crossing, bool | None]]:
    """Return the crossings of the true curves, and whether what is said of them is right; None if nothing is."""
    curves = [np.ascontiguousarray(curve[::2]) for curve in scene.curves]
    names = [str(k) for k in range(len(curves))]
    found = find_layers(find_crossings(curves, names), curves, names, list(scene.widths), depth, rgb)
    lengths = [float(np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()) for curve in curves]
    out = []
    for each in found:
        (true,) = [c for c in scene.crossings if np.hypot(*(c.place - each.pixel)) < 2] or [None]
        if true is not None:
            at = each.arcs[0] * lengths[int(each.slots[0])]
            first = int(each.slots[0]) == true.first and abs(at - true.first_at) < 20
            out.append((each, None if each.above is None else (each.above == 0) == (first == true.first_above)))
    return out


def scenes(count: int, **options) -> list[RopeScene]:
    return [several_ropes(np.random.default_rng(k), 2 + k % 2, 3, **options) for k in range(count)]


def test_the_picture_shows_which_strand_is_above():
    said = [right for scene in scenes(10) for _, right in judged(scene, _NONE, scene.rgb)]
    assert len(said) >= 25
    assert said.count(False) == 0
    assert said.count(None) <= 0.05 * len(said)


def test_the_depth_of_a_d455_shows_which_strand_is_above():
    said = []
    for k, scene in enumerate(scenes(10, width=9.0)):
        said += [r for _, r in judged(scene, depth_images(noisy_depth(scene, np.random.default_rng(k))), None)]
    assert len(said) >= 25
    assert said.count(False) <= 0.04 * len(said)
    assert said.count(True) >= 0.9 * len(said)


@pytest.mark.parametrize("rgb", [None, np.full((480, 640, 3), 120, np.uint8)])
def test_without_evidence_nothing_is_said(rgb):
    (scene,) = scenes(1)
    assert {right for _, right in judged(scene, _NONE, rgb)} == {None}
    flat = depth_images(np.full((480, 640), 0.6, np.float32))
    assert {right for _, right in judged(scene, flat, rgb)} == {None}
    nothing = depth_images(np.zeros((480, 640), np.uint16))
    assert {right for _, right in judged(scene, nothing, rgb)} == {None}
    assert find_layers((), [], [], [], _NONE, rgb) == ()
