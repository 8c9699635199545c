"""The D455 model compared with its closed forms: noise, steps and holes of depth; noise and light of colour."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from shape_obs_envs.d455 import Cause, D455Camera, D455Model, Light, Measurement

MODEL = D455Model()
PRODUCT = 386 * 0.095  # f B
CLEAR = D455Model(
    subpixel=0, disparity_step=0, left_band=False, edge_share=0, dark_share=0, speckle_share=0, min_z=0, max_z=None,
    exposure=0, white_balance=0, drift=0, read=0, shot=0,
)  # fmt: skip
NATIVE, SMALL = (480, 640), (120, 160)
FORMS = pytest.mark.parametrize("fast", [False, True], ids=["exact", "fast"])


def measure(
    model: D455Model, metres: Any, fast: bool = False, value: int = 255, seed: int = 0, frames: int = 1
) -> list[Measurement]:
    """Return frames of one scene with one brightness."""
    metres = np.asarray(metres)
    camera, rng = D455Camera(model, metres.shape, fast), np.random.default_rng(seed)
    rgb = np.full((*metres.shape, 3), value, np.uint8)
    return [camera.measure(metres, rgb, rng) for _ in range(frames)]


def share(found: list[Measurement], cause: Cause, where: Any = slice(None)) -> float:
    return float(np.mean([frame.lost_to(cause)[where].mean() for frame in found]))


# ---- depth


@FORMS
@pytest.mark.parametrize("size", [NATIVE, SMALL], ids=["native", "small"])
@pytest.mark.parametrize("z", [0.4, 0.6, 0.8, 1.0, 1.25, 1.5])
def test_noise_is_that_of_the_formula(z, size, fast):
    found = measure(MODEL, np.full(size, z), fast, frames=2 if size == NATIVE else 12)
    values = np.concatenate([frame.metres[frame.causes == 0] for frame in found])
    sigma = z**2 * 0.08 / PRODUCT
    assert MODEL.sigma(z) == pytest.approx(sigma)
    assert values.std() == pytest.approx(sigma, rel=0.2)
    rounding = z**2 / (32 * PRODUCT)
    assert values.std() == pytest.approx(math.hypot(sigma, rounding / math.sqrt(12)), rel=0.04)
    assert values.mean() == pytest.approx(z, abs=0.1 * sigma)


@pytest.mark.nightly
@FORMS
@pytest.mark.parametrize("size", [NATIVE, (960, 1280)], ids=["native", "double"])
def test_noise_correlates_over_native_pixels(size, fast):
    model = replace(CLEAR, subpixel=0.08, correlation=2.0)
    error = PRODUCT / measure(model, np.full(size, 1.0), fast)[0].metres - PRODUCT
    error /= error.std()
    for lag in (1, 2, 4, 8):
        expected = math.exp(-((lag * 480 / size[0]) ** 2) / 16)
        assert (error[:, lag:] * error[:, :-lag]).mean() == pytest.approx(expected, abs=0.05)
        assert (error[lag:] * error[:-lag]).mean() == pytest.approx(expected, abs=0.05)


def test_depth_comes_in_steps_of_disparity():
    ramp = np.linspace(0.9, 1.1, SMALL[0] * SMALL[1]).reshape(SMALL)
    (found,) = measure(replace(CLEAR, disparity_step=1 / 32), ramp)
    steps = PRODUCT * 32 / found.metres.astype(np.float64)
    assert np.abs(steps - np.rint(steps)).max() < 1e-3
    depths = np.unique(found.metres).astype(np.float64)
    middle = (depths[1:] + depths[:-1]) / 2
    assert np.allclose(np.diff(depths), middle**2 / (32 * PRODUCT), rtol=1e-3)
    assert MODEL.depth_step(0.7) == pytest.approx(0.7**2 / (32 * PRODUCT))
    assert np.abs(found.metres - ramp).max() <= 0.51 * MODEL.depth_step(1.1)


@pytest.mark.parametrize("size", [NATIVE, SMALL, (120, 120), (240, 480)])
@pytest.mark.parametrize("z", [0.35, 0.5, 1.0, 3.0])
def test_left_band_is_as_wide_as_the_disparity(z, size):
    (found,) = measure(replace(CLEAR, left_band=True), np.full(size, z))
    band = found.lost_to(Cause.LEFT_BAND)
    width = band.sum(axis=1)
    # a narrower image is a crop about the centre
    cropped = max(0, 640 - size[1] * 480 / size[0]) / 2
    assert np.abs(width - max(0, PRODUCT / z - cropped) * size[0] / 480).max() <= 0.51
    assert band[:, : width[0]].all()
    assert not found.metres[band].any()
    assert np.allclose(found.metres[~band], z)
    assert MODEL.band_width(z) == pytest.approx(PRODUCT / z)


@FORMS
def test_depths_outside_the_range_are_lost(fast):
    ramp = np.broadcast_to(np.linspace(0.05, 9, 640), NATIVE)
    (found,) = measure(replace(CLEAR, min_z=0.32, max_z=6.0), ramp, fast)
    assert np.array_equal(found.lost_to(Cause.NEAR), ramp < 0.32)
    assert np.array_equal(found.lost_to(Cause.FAR), ramp > 6)
    (found,) = measure(replace(MODEL, left_band=False), ramp, fast)
    seen = found.metres[found.metres > 0]
    assert seen.min() >= 0.32 - 1e-6
    assert seen.max() <= 6 + 1e-4
    (found,) = measure(replace(CLEAR, subpixel=0.08), ramp, fast)
    assert found.metres.min() > 0.049


@pytest.mark.parametrize("nothing", [0.0, -1.0, np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_what_the_clean_image_lacks_stays_missing(nothing, dtype):
    metres = np.full(SMALL, 1.0, dtype)
    metres[50:70, 100:120] = nothing
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (found,) = measure(MODEL, metres)
    missing = np.isin(found.causes & Cause.MISSING, Cause.MISSING)
    assert np.array_equal(missing, metres != 1)
    assert not (found.causes & Cause.FAR).any()
    assert found.lost_to(Cause.EDGE).any(), "an object before nothing has an edge"
    assert np.array_equal(found.metres == 0, found.causes != 0)


# ---- holes by cause


@FORMS
@pytest.mark.parametrize("size", [NATIVE, SMALL], ids=["native", "small"])
@pytest.mark.parametrize("value", [0, 20, 50, 79, 80, 200])
def test_dark_surfaces_lose_their_share(value, size, fast):
    found = measure(MODEL, np.full(size, 1.0), fast, value, frames=3 if size == NATIVE else 12)
    designed = 0.8 * max(0, 1 - value / 80)
    assert MODEL.dark_probability(value) == pytest.approx(designed)
    assert share(found, Cause.DARK) == pytest.approx(designed, rel=0.05, abs=1 / 255)


@FORMS
@pytest.mark.parametrize("colour", [(10, 10, 200), (200, 0, 0), (0, 90, 0)])
def test_strong_colours_are_not_dark(colour, fast):
    camera = D455Camera(MODEL, SMALL, fast)
    rgb = np.broadcast_to(np.array(colour, np.uint8), (*SMALL, 3))
    found = camera.measure(np.full(SMALL, 1.0), rgb, np.random.default_rng(0))
    assert not found.lost_to(Cause.DARK).any()


@FORMS
@pytest.mark.parametrize("size", [NATIVE, SMALL], ids=["native", "small"])
def test_speckle_takes_its_share_in_blobs(size, fast):
    model = replace(CLEAR, speckle_share=0.01)
    found = measure(model, np.full(size, 1.0), fast, frames=10 if size == NATIVE else 100)
    assert share(found, Cause.SPECKLE) == pytest.approx(0.01, rel=0.1)
    if size == NATIVE:
        lost = np.stack([frame.lost_to(Cause.SPECKLE) for frame in found])
        paired = (lost[:, :, 1:] & lost[:, :, :-1]).sum() / lost.sum()
        assert paired > 0.5, "single pixels"


@FORMS
@pytest.mark.parametrize("rows", [84, 120, 480, 960])
def test_pixels_next_to_a_jump_lose_their_share(rows, fast):
    size = (rows, rows * 4 // 3)
    reach, probability = MODEL.edge_reach(rows)
    assert reach * probability == pytest.approx(0.3 * 2 * rows / 480, rel=0.01)
    period = 12 * reach
    column = np.arange(size[1]) % period
    steps = np.broadcast_to(np.where(column < period // 2, 0.8, 0.6), size)
    apart = np.minimum(column % (period // 2), (-1 - column) % (period // 2))
    inner = (np.arange(size[1]) >= reach) & (np.arange(size[1]) < size[1] - reach)  # no step at the border
    near = np.broadcast_to((apart < reach) & inner, size)
    far = np.broadcast_to(apart >= reach, size)
    found = measure(replace(CLEAR, edge_share=0.3), steps, fast, frames=max(2, 5000 // rows))
    assert share(found, Cause.EDGE, near) == pytest.approx(probability, rel=0.06)
    assert share(found, Cause.EDGE, far) == 0


@pytest.mark.parametrize("size", [(84, 84), NATIVE])
def test_steep_slopes_are_no_jumps(size):
    v, u = np.mgrid[: size[0], : size[1]] * (480 / size[0]) / 386
    for slope in ((1.5, 0), (0, -1.5), (1, 1)):  # of a plane z = 1 + a x + b y
        plane = 1 / np.maximum(1 - slope[0] * (u - u.mean()) - slope[1] * (v - v.mean()), 0.1)
        (found,) = measure(replace(CLEAR, edge_share=1), plane)
        assert not found.lost_to(Cause.EDGE)[1:-1, 1:-1].any()
    # a rope of 16 mm on a table at 0.56 m is no slope, and its table is none either
    (found,) = measure(replace(CLEAR, edge_share=1), np.where(np.abs(v - v.mean()) < 0.02, 0.544, 0.56))
    assert found.lost_to(Cause.EDGE).any(axis=1).sum() == 4 * MODEL.edge_reach(size[0])[0]


@pytest.mark.parametrize(
    ("field", "cause"),
    [("left_band", Cause.LEFT_BAND), ("edge_share", Cause.EDGE), ("dark_share", Cause.DARK),
     ("speckle_share", Cause.SPECKLE), ("min_z", Cause.NEAR), ("max_z", Cause.FAR)],
)  # fmt: skip
def test_each_cause_can_be_switched_off_and_be_alone(field, cause):
    scene = np.broadcast_to(np.where(np.arange(160) % 40 < 20, 0.8, 0.9), SMALL).copy()
    scene[:10], scene[-10:] = 0.2, 7
    (whole,) = measure(MODEL, scene, value=20)
    assert share([whole], cause) > 0
    off = {field: None if field == "max_z" else 0} if field != "left_band" else {field: False}
    (without,) = measure(replace(MODEL, **off), scene, value=20)
    assert share([without], cause) == 0
    (alone,) = measure(replace(CLEAR, **{field: getattr(MODEL, field)}), scene, value=20)
    assert set(np.unique(alone.causes)) == {0, int(cause)}
    (nothing,) = measure(CLEAR, scene, value=20)
    assert not nothing.causes.any()
    assert np.allclose(nothing.metres, scene)


# ---- colour


@FORMS
@pytest.mark.parametrize("value", [20, 100, 220])
def test_colour_noise_grows_with_brightness(value, fast):
    camera, rng = D455Camera(replace(MODEL, read=2.0, shot=0.05), SMALL, fast), np.random.default_rng(0)
    rgb = np.full((*SMALL, 3), value, np.uint8)
    error = np.stack([camera.colour(rgb, Light(), rng) for _ in range(5)]).astype(float) - value
    assert error.var() == pytest.approx(2**2 + 0.05 * value + 1 / 12, rel=0.03)
    assert abs(error.mean()) < 0.05
    channels = np.corrcoef(error.reshape(-1, 3).T)
    assert np.abs(channels - np.eye(3)).max() < 0.02
    assert abs(np.corrcoef(error[0].ravel(), error[1].ravel())[0, 1]) < 0.02


@FORMS
def test_gains_are_those_of_the_light(fast):
    camera, rng = D455Camera(replace(MODEL, read=0, shot=0), SMALL, fast), np.random.default_rng(0)
    light = Light(episode=(math.log(1.2), math.log(0.9), 0.0), wander=(0.0, 0.0, math.log(1.1)))
    assert light.gains == pytest.approx((1.08, 1.2, 1.32))
    rgb = np.broadcast_to(np.array([50, 100, 150], np.uint8), (*SMALL, 3))
    assert np.array_equal(np.unique(camera.colour(rgb, light, rng).reshape(-1, 3), axis=0), [[54, 120, 198]])
    bright = camera.colour(np.full((*SMALL, 3), 250, np.uint8), light, rng)
    assert (bright == 255).all(), "no wrap-around"
    noisy = D455Camera(replace(MODEL, read=20), SMALL, fast)
    for value in (0, 255):
        picture = noisy.colour(np.full((*SMALL, 3), value, np.uint8), Light(), rng)
        assert np.abs(picture.astype(int) - value).max() < 120, "no wrap-around"


def test_light_is_drawn_for_an_episode_and_wanders_in_it():
    model, rng = replace(MODEL, exposure=0.1, white_balance=0.05, drift=0.5, drift_frames=20), np.random.default_rng(0)
    start = [Light.draw(model, rng) for _ in range(4000)]
    assert np.std([light.episode for light in start], axis=0) == pytest.approx([0.1, 0.05, 0.05], rel=0.05)
    assert np.std([light.wander for light in start], axis=0) == pytest.approx([0.05, 0.025, 0.025], rel=0.05)
    walks = []
    for light in start[:1000]:
        walk = [light]
        for _ in range(20):
            walk.append(walk[-1].later(model, rng))
        assert all(later.episode == light.episode for later in walk)
        walks.append([later.wander for later in walk])
    wander = np.array(walks)
    assert wander[:, -1].std(axis=0) == pytest.approx([0.05, 0.025, 0.025], rel=0.1)
    assert np.corrcoef(wander[:, 0, 0], wander[:, -1, 0])[0, 1] == pytest.approx(math.exp(-1), abs=0.1)
    assert Light.draw(CLEAR, rng).later(CLEAR, rng) == Light()


def test_bad_images():
    camera, rng, rgb = D455Camera(MODEL, SMALL), np.random.default_rng(0), np.zeros((*SMALL, 3), np.uint8)
    with pytest.raises(ValueError, match=r"metres: expected \(120, 160\) floats, got \(120, 160\) uint16. Divide"):
        camera.measure(np.full(SMALL, 700, np.uint16), rgb, rng)
    with pytest.raises(ValueError, match=r"rgb: expected \(120, 160, 3\) uint8, got \(84, 84, 3\) uint8"):
        camera.colour(np.zeros((84, 84, 3), np.uint8), Light(), rng)
    with pytest.raises(ValueError, match=r"size: expected \(height, width\) in pixels, .* got \(120,\)"):
        D455Camera(MODEL, (120,))
