"""Bad input leads to a clear error or to the declared policy, never to a warning or a crash."""

from __future__ import annotations

import warnings

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from shape_obs import (
    CameraModel,
    Centerline,
    DepthRange,
    GrayRange,
    HSVRange,
    Intrinsics,
    Polygon,
    Rectangle,
    ShapeDetector,
    ShapeLostError,
    Surface,
    Target,
)
from shape_obs.calibration.hand_eye import fit_base, marker_points
from shape_obs.config.detector_config import DetectorConfig
from shape_obs.features import EllipticFourier, Points3D
from shape_obs.markers.sheet import marker_pages
from shape_obs.metrics import silhouette
from shape_obs.recording import OverlayVideo
from shape_obs.servo import ShapeServo
from shape_obs.source import SourceError
from shape_obs_envs.mujoco.randomization import Randomization
from shape_obs_envs.mujoco.randomization.hand_occluder import Hand
from shape_obs_envs.robots.frame_publisher import Faults
from shape_obs_envs.sources import FolderSource, VideoSource, WebcamSource
from shape_obs_envs.sources.realsense import RealSenseSource
from shape_obs_envs.sources.realsense.settings import check_filters

BLUE = HSVRange((100, 100, 60), (125, 255, 255))
LENS = Intrinsics(640, 480, 600.0, 600.0, 320.0, 240.0)


@pytest.fixture(autouse=True)
def _no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message="(depth|cloud): the object is")  # declared: a wrong unit
        yield


def far(mask: np.ndarray, metres: float = 0.7) -> np.ndarray:
    return np.full(mask.shape[:2], metres, np.float32)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"rgb": None}, ValueError, "detect needs an rgb or a depth image, got neither."),
        ({"rgb": [[1, 2, 3]]}, TypeError, "rgb: expected a numpy array of uint8 .0...255., got list"),
        ({"rgb": np.zeros((9, 9, 3))}, TypeError, "got an array of float64; scale floats in 0...1 by 255"),
        ({"rgb": np.zeros((9, 9), np.uint8)}, ValueError, r"rgb: expected shape \(H, W, 3\), RGB order, got \(9, 9\)"),
        ({"depth": np.zeros((240, 320), np.int32)}, TypeError, "depth: expected 16-bit millimetres or floating"),
        ({"depth": np.zeros((240, 320, 3), np.float32)}, ValueError, r"depth: expected shape \(H, W\), got \(240"),
        ({"depth": np.zeros((480, 640), np.uint16)}, ValueError, "depth has 640 x 480 pixels, rgb has 320 x 240 pixel"),
        ({"camera": Intrinsics(640, 480, 1, 1, 0, 0)}, ValueError, "intrinsics are for 640 x 480 pixels, the image"),
        ({"camera": "d455"}, TypeError, "camera: expected Intrinsics, a CameraModel, .* got str"),
        ({"rgb": np.zeros((3, 240, 320), np.uint8)}, ValueError, r"give rgb.transpose\(1, 2, 0\)"),
        ({"rgb": np.ma.masked_less(np.zeros((240, 320, 3), np.uint8), 9)}, ValueError, "rgb: the mask of this masked"),
        ({"stamp": float("nan")}, ValueError, "stamp must be a finite number of seconds, got nan"),
        ({"stamp": "now"}, TypeError, "stamp must be a number of seconds, got 'now'"),
        ({"stamp": np.timedelta64("NaT")}, ValueError, "stamp must be a finite number of seconds, got nan"),
    ],
)  # fmt: skip
def test_a_wrong_frame_is_reported(blue, arguments, error, message):
    with pytest.raises(error, match=message):
        ShapeDetector(segmentation=BLUE).detect(**{"rgb": blue, **arguments})


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"mask": np.zeros((2, 2, 2, 2), bool)}, ValueError, r"got \(2, 2, 2, 2\)\."),
        ({"mask": None}, TypeError, "mask: expected a numpy array of bool or uint8, got NoneType"),
        ({"depth": np.zeros((9, 9), np.uint16)}, ValueError, "the mask has 320 x 240 pixels, depth 9 x 9: they must"),
        ({"camera": Intrinsics(9, 9, 1, 1, 0, 0)}, ValueError, "the camera's intrinsics 9 x 9: they must be equal"),
    ],
)  # fmt: skip
def test_a_wrong_mask_is_reported(wave, arguments, error, message):
    with pytest.raises(error, match=message):
        ShapeDetector().detect_mask(**{"mask": wave.mask, **arguments})


def test_a_refused_frame_leaves_the_track_alone(blue):
    detector = ShapeDetector(segmentation=BLUE)
    detector.detect(blue, stamp=0.0)
    with pytest.raises(ValueError, match="stamp"):
        detector.detect(blue, stamp=float("nan"))
    assert detector.detect(blue).stamp == pytest.approx(1 / 30)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Surface(rows=1), "rows and cols must lie in 2...100, got 1 and"),
        (lambda: Surface(epochs=101), "epochs must lie in 0...100, got 101"),
        (lambda: Surface(freedom=0), "freedom must lie above 0, up to 1, got 0"),
        (lambda: GrayRange(open=-1), "open and close must be >= 0 and min_area >= 1"),
        (lambda: GrayRange(min_share=2.0), "min_share must lie in 0...1, got 2.0"),
        (lambda: Rectangle(0, 0, 0, 9), "width and height must be positive, got 0 x 9"),
        (lambda: Polygon(((0, 0), (9, 9))), "needs at least three corners, got 2"),
        (lambda: Polygon(((0, 0), (9, 9), (0, np.inf))), "corners must be finite"),
        (lambda: Points3D(frame="anchor", origin="centroid"), "frame 'anchor' already has an origin"),
        (lambda: EllipticFourier(harmonics=0), "needs at least 1 harmonic, got 0"),
        (lambda: DetectorConfig(shapes=()), "expected at least one configuration, got none"),
        (lambda: Randomization.of({"hand": 1}), "hand: expected True, False or a mapping of its fields"),
        (lambda: Randomization.of({"others": 1}), "others: expected True or False, got 1"),
        (lambda: Hand(speed=(0.1, 0.05)), r"hand.speed: expected two numbers within 0.005 ... 0.3, got \(0.1"),
        (lambda: check_filters("spatial"), r"expected a sequence of names, got 'spatial'; write \('spatial',\)"),
        (lambda: check_filters(("sharpen",)), "filters: expected .*'hole_filling', got 'sharpen'"),
        (lambda: CameraModel(LENS).to_base((0, 0, 1)), "this needs the camera's place in the base frame"),
        (lambda: fit_base(np.zeros((4, 2)), np.zeros((4, 2))), r"expected two arrays of shape \(K, 3\), got \(4, 2"),
        (lambda: fit_base(np.full((4, 3), np.nan), np.eye(4)[:, :3]), "expected finite metres"),
        (lambda: silhouette(np.eye(9), np.arange(9) % 2, sample=0), "sample: expected None or at least 1, got 0"),
        (lambda: ShapeServo("mfac", 2, weights="deal"), r"weights are 'noise', a matrix \(M,F\) or None, got 'deal'"),
        (lambda: marker_pages((0,), 3), "markers of 3 mm are too small to print: give at least"),
        (lambda: OverlayVideo("o.txt"), "o.txt: expected a video named "),
        (lambda: marker_points(np.eye(4)[:, :2] * 9, LENS, np.zeros((480, 640))), "not enough depth on the marker"),
        (lambda: Target(((0.1, 0, 0), (0.2, 0, 0)), size=(640, 480)), "goal: size is that of an image"),
        (lambda: RealSenseSource(recording="a.bag", exposure=0.01), "recording: its images are as they were taken"),
        (lambda: WebcamSource("/dev/none").connect(), "there is no /dev/none"),
        (lambda: VideoSource("none.mp4").connect(), "none.mp4: no such file"),
        (lambda: FolderSource("none").connect(), "none: no such folder"),
        (lambda: Faults(drop=0.7, black=0.7), "shares from 0 to 1, with a sum of at most 1"),
    ],
)  # fmt: skip
def test_a_value_that_cannot_be_right_is_refused_where_it_is_given(make, message):
    with pytest.raises((ValueError, SourceError), match=message):
        make()


def test_what_a_rule_reads_must_be_there(blue):
    with pytest.raises(ValueError, match=r"segmentation 'hsv' needs rgb, but the frame has none."):
        ShapeDetector(segmentation=BLUE).detect(None, np.zeros((9, 9), np.uint16))
    with pytest.raises(ValueError, match=r"segmentation 'depth' needs depth, but the frame has none."):
        ShapeDetector(segmentation=DepthRange(0.1, 1)).detect(blue)
    with pytest.raises(ValueError, match="shape 'centerline' has no segmentation: pass segmentation=HSVRange"):
        ShapeDetector().detect(blue)


@pytest.mark.parametrize(("pixels", "reason"), [(0, "is empty"), (15, "has 15 pixels, at least 16 are needed")])
def test_too_few_pixels_lose_the_shape_and_say_why(pixels, reason):
    mask = np.zeros((60, 80), bool)
    mask.ravel()[1000 : 1000 + pixels] = True
    shape = ShapeDetector(segmentation=GrayRange(min_area=1)).detect_mask(mask).shapes[0]
    assert (shape.ok, shape.reason) == (False, f"the mask {reason}")
    assert np.isnan(shape.points2d).all()


def test_a_table_full_of_specks_is_no_rope_and_takes_no_time():
    """Joining pieces costs the cube of their number: hundreds of them would take minutes."""
    mask = np.zeros((480, 640), bool)
    for row in range(10, 470, 20):
        for column in range(10, 630, 20):
            mask[row : row + 6, column : column + 6] = True
    shape = ShapeDetector().detect_mask(mask).shapes[0]
    assert not shape.ok
    assert shape.reason == "the mask falls into 713 pieces, at most 16"


def test_a_blob_is_refused():
    """The masks are those of a colour range that is too wide."""
    whole, disc, cross = np.zeros((3, 240, 320), np.uint8)
    whole[:] = cross[20:220, 150:170] = cross[110:130, 60:260] = 1
    cv2.circle(disc, (160, 120), 60, 1, -1)
    for mask in (whole, disc, cross):
        shape = ShapeDetector().detect_mask(mask).shapes[0]
        assert not shape.ok
        assert any(word in shape.reason for word in ("too stout for a rope", "it is no single rope", "branches"))


@pytest.mark.parametrize("hole", [0.0, np.nan, np.inf, -1.0])
def test_depth_without_a_valid_value_loses_the_shape(wave, intrinsics, hole):
    shape = ShapeDetector().detect_mask(wave.mask, far(wave.mask, hole), intrinsics).shapes[0]
    assert (shape.ok, shape.reason) == (False, "no point has depth under it")
    with pytest.raises(ShapeLostError, match="shape 'centerline' was not found: no point has depth under it"):
        ShapeDetector(on_missing="raise").detect_mask(wave.mask, far(wave.mask, hole), intrinsics)
    millimetres = np.zeros(wave.mask.shape, np.uint16)
    assert not ShapeDetector().detect_mask(wave.mask, millimetres, intrinsics).shapes[0].ok


@pytest.mark.parametrize("spacing", ["px", "m"])
def test_absurd_depth_counts_as_none(wave, intrinsics, spacing):
    depth = far(wave.mask).astype(np.float64)
    depth[:, 150:] = 1e300
    detector = ShapeDetector(Centerline(spacing=spacing))
    shape = detector.detect_mask(wave.mask, depth, intrinsics).shapes[0]
    assert shape.points3d is not None
    assert shape.valid[:6].all()
    assert not shape.valid[-8:].any()
    assert np.isnan(shape.points3d[-8:]).all()


def test_equal_spacing_in_metres_needs_depth(wave, intrinsics):
    with pytest.raises(ValueError, match="spacing='m' needs depth and a camera; give both, or spacing='px'"):
        ShapeDetector(Centerline(spacing="m")).detect_mask(wave.mask, None, intrinsics)


SHAPE = st.tuples(st.integers(1, 40), st.integers(1, 60))
RULES = st.builds(GrayRange, low=st.integers(0, 255), open=st.integers(0, 3), close=st.integers(0, 4),
                  min_area=st.integers(1, 30), min_share=st.floats(0, 1))  # fmt: skip
METRES = st.floats(-1, 3, width=32) | st.sampled_from([0.0, np.nan, np.inf, -np.inf, float(np.float32(3e38))])


@settings(max_examples=40)
@given(st.data(), SHAPE, st.integers(2, 40), RULES)
def test_garbage_masks_and_depth_never_break_the_detector(data, size, n, rule):
    spacing, on_invalid = (data.draw(st.sampled_from(names)) for names in (["px", "m"], ["nan", "interpolate", "hold"]))
    camera = CameraModel(Intrinsics(size[1], size[0], 50.0, 50.0, size[1] / 2, size[0] / 2), np.eye(4))
    spec = Centerline(n=n, spacing=spacing, anchor=data.draw(st.sampled_from([None, (3.0, 4.0), (0.0, 0.0, 1.0)])),
                      ends=data.draw(st.sampled_from(["tips", "centers"])))  # fmt: skip
    detector = ShapeDetector(spec, rule, on_invalid=on_invalid, max_age=0.05)
    for _ in range(3):
        mask = data.draw(hnp.arrays(bool, size, elements=st.booleans(), fill=st.booleans()))
        depth = data.draw(hnp.arrays(np.float32, size, elements=METRES, fill=METRES))
        detector.detect_mask(mask, depth, camera)


@pytest.mark.parametrize("upright", [False, True])
def test_a_rope_one_pixel_thick_is_followed_to_its_ends(upright):
    mask = np.zeros((60, 100), bool)
    mask[30, 10:90] = True
    shape = ShapeDetector(Centerline(n=5, ends="tips")).detect_mask(mask.T if upright else mask).shapes[0]
    along, across = (1, 0) if upright else (0, 1)
    np.testing.assert_allclose(shape.points2d[:, across], 30, atol=0.3)
    np.testing.assert_allclose(shape.points2d[:, along], np.linspace(9.5, 89.5, 5), atol=1)
