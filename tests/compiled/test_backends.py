"""NumPy and Numba run the same loops: what comes out agrees to a thousandth of a pixel."""

from __future__ import annotations

import inspect

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shape_obs import Centerline, HSVRange, ShapeDetector
from shape_obs.bench.synthetic.images import hidden_rope, photographed
from shape_obs.bench.synthetic.ropes import moving_rope, random_rope
from shape_obs.bench.synthetic.tangles import crossing_rope, cut_rope
from shape_obs.compiled import NUMPY, choose
from shape_obs.geometry.topology import Chain, Grid, Ring

pytest.importorskip("numba", reason="Numba is an extra: pip install 'shape-obs[fast]'")
NUMBA = choose("numba")
BLUE = HSVRange(low=(100, 80, 25), high=(130, 255, 255))
CLOSE = 1e-3


def both(shapes=None, segmentation=None, **options):
    return [ShapeDetector(shapes, segmentation, backend=backend, **options) for backend in ("numpy", "numba")]


def agree(first, second):
    for one, other in zip(first, second, strict=True):
        assert one.ok == other.ok
        assert one.reason == other.reason
        np.testing.assert_allclose(one.points2d, other.points2d, atol=CLOSE)
        np.testing.assert_array_equal(one.visible, other.visible)
        assert one.quality == pytest.approx(other.quality, abs=1e-3)
        if one.points3d is not None:
            np.testing.assert_allclose(one.points3d, other.points3d, atol=1e-5)


def test_backends_have_the_same_functions():
    offered = [vars(kernels)["__all__"] for kernels in (NUMPY, NUMBA)]
    assert offered[0] == offered[1]
    names = [name for name in offered[0] if callable(getattr(NUMPY, name))]
    for name in names:
        first, second = getattr(NUMPY, name), getattr(NUMBA, name)
        written = [inspect.signature(getattr(function, "py_func", function)) for function in (first, second)]
        assert [*written[0].parameters] == [*written[1].parameters], name


@pytest.mark.parametrize("kind", ["smooth", "u", "s", "hairpin", "loop", "spiral", "fat"])
def test_a_cold_rope(kind):
    rng = np.random.default_rng(3)
    for spec in (Centerline(n=8, ends="tips"), Centerline(n=20, ends="centers")):
        mask = random_rope(rng, kind).mask
        numpy, numba = both(spec)
        agree(numpy.detect_mask(mask), numba.detect_mask(mask))


def test_ropes_that_cross_or_are_cut():
    rng = np.random.default_rng(5)
    for tangle in (crossing_rope(rng, 1), crossing_rope(rng, 2), cut_rope(rng, 1, 16)):
        numpy, numba = both()
        agree(numpy.detect_mask(tangle.mask), numba.detect_mask(tangle.mask))


@pytest.mark.parametrize("speed", [4, 25])
def test_a_tracked_rope(speed):
    numpy, numba = both(Centerline(n=20, ends="tips"))
    for rope in moving_rope(np.random.default_rng(2), speed, 60):
        agree(numpy.detect_mask(rope.mask), numba.detect_mask(rope.mask))


@pytest.mark.parametrize("where", ["start", "middle"])
def test_a_tracked_rope_under_a_hand(where):
    numpy, numba = both()
    for hidden in hidden_rope(np.random.default_rng(7), 6, 0.25, where, frames=40):
        agree(numpy.detect_mask(hidden.mask), numba.detect_mask(hidden.mask))


def test_a_tracked_rope_in_images_with_depth(intrinsics):
    rng = np.random.default_rng(4)
    numpy, numba = both(Centerline(), BLUE)
    for rope in moving_rope(rng, 6, 20, length=180):
        image = photographed(rng, rope.mask, 1.5, 4.0)[:240, :320]
        depth = rng.integers(700, 720, image.shape[:2]).astype(np.uint16)
        depth[rng.random(depth.shape) < 0.2] = 0
        agree(numpy.detect(image, depth, intrinsics), numba.detect(image, depth, intrinsics))


@given(st.integers(0, 2**32 - 1), st.integers(1, 40), st.integers(1, 60), st.sampled_from([0.02, 0.3, 0.7, 1.0]))
def test_any_mask_is_surveyed_alike(seed, height, width, share):
    rng = np.random.default_rng(seed)
    mask = (rng.random((height, width)) < share).astype(np.uint8) * 255
    for least, part in ((1, 0.0), (4, 0.1)):
        one, other = (kernels.survey(mask, 5, 7, least, part) for kernels in (NUMPY, NUMBA))
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])
        assert one[2:] == other[2:]
        for edge in (1, 3, 8):
            for values, others in zip(NUMPY.cells(one[0], edge), NUMBA.cells(one[0], edge), strict=True):
                np.testing.assert_allclose(values, others, atol=1e-9)
    assert np.sum(one[1]) == np.sum(one[0][:, 2] - one[0][:, 1])


@given(st.integers(0, 2**32 - 1), st.sampled_from([Chain(7), Ring(9), Grid(3, 4)]))
def test_maps_settle_alike(seed, topology):
    rng = np.random.default_rng(seed)
    points, weight, nodes = rng.uniform(0, 100, (60, 2)), rng.uniform(1, 5, 60), rng.uniform(0, 100, (topology.size, 2))
    moments = topology.neighbourhoods((0.8, 0.4))
    one, other = (kernels.settle(points, weight, nodes, *moments) for kernels in (NUMPY, NUMBA))
    np.testing.assert_allclose(one, other, atol=1e-6)


@given(st.integers(0, 2**32 - 1), st.booleans(), st.integers(2, 3))
def test_curves_are_drawn_alike(seed, closed, dimension):
    nodes = np.random.default_rng(seed).uniform(0, 100, (9, dimension))
    one, other = (kernels.catmull_rom(nodes, 4, closed) for kernels in (NUMPY, NUMBA))
    np.testing.assert_allclose(one, other, atol=1e-9)
    arc = NUMPY.arc_length(one)
    np.testing.assert_allclose(arc, NUMBA.arc_length(one), atol=1e-9)
    at = np.random.default_rng(seed).uniform(-1, arc[-1] + 1, 20)
    np.testing.assert_allclose(NUMPY.interpolate(one, arc, at), NUMBA.interpolate(one, arc, at), atol=1e-9)
    even = [kernels.equidistant(one, arc, 8, 0.0, 0.35) for kernels in (NUMPY, NUMBA)]
    np.testing.assert_allclose(even[0], even[1], atol=1e-6)


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.sampled_from([np.uint16, np.float32, np.float64]))
def test_depth_is_read_alike(seed, kind):
    rng = np.random.default_rng(seed)
    depth = rng.integers(0, 3, (40, 50)).astype(kind) * rng.uniform(0.5, 700, (40, 50)).astype(kind)
    mask = (rng.random((30, 40)) < 0.7).astype(np.uint8)
    points = rng.uniform(-3, 45, (12, 2))
    for reach in (1, 4):
        found = [kernels.median_depth(depth, 1e-3, mask, 4, 6, points, reach, 0.25) for kernels in (NUMPY, NUMBA)]
        np.testing.assert_allclose(found[0], found[1], rtol=1e-6)


def test_numba_that_is_missing_is_told(monkeypatch):
    from shape_obs.compiled import choice

    choice.choose.cache_clear()
    monkeypatch.setattr(choice, "find_spec", lambda name: None)
    try:
        with pytest.raises(ImportError, match=r"shape-obs\[fast\]"):
            ShapeDetector(backend="numba")
        assert ShapeDetector(backend="auto").kernels is NUMPY
    finally:
        choice.choose.cache_clear()


def test_numba_that_does_not_work_is_told(monkeypatch):
    from shape_obs.compiled import choice

    load = choice._load

    def broken(backend):
        if backend == "numba":
            raise RuntimeError("cannot cache function 'f': no locator available for file 'f.py'")
        return load(backend)

    choice.choose.cache_clear()
    monkeypatch.setattr(choice, "_load", broken)
    try:
        with pytest.raises(ImportError, match="NUMBA_CACHE_DIR"):
            ShapeDetector(backend="numba")
        with pytest.warns(RuntimeWarning, match="run on NumPy"):
            assert ShapeDetector(backend="auto").kernels is NUMPY
    finally:
        choice.choose.cache_clear()


def test_an_unknown_backend_is_told():
    with pytest.raises(ValueError, match="did you mean 'numba'"):
        ShapeDetector(backend="nubma")
