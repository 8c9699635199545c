"""Projection and back, against OpenCV, librealsense and plain matrices, and cameras as other libraries have them."""

from __future__ import annotations

import ctypes
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shape_obs import CameraModel, Intrinsics, ShapeDetector
from shape_obs.calibration.hand_eye import marker_points
from shape_obs.camera import DepthNoise, as_camera_model
from shape_obs.extrinsics import Extrinsics
from shape_obs.features import FeatureContext
from shape_obs_envs.sources import WebcamSource
from shape_obs_envs.sources.registration import Registration

MODELS = ("pinhole", "brown_conrady", "inverse_brown_conrady")
# a real D455 at 1280 x 800, the magnitudes of librealsense's and of wider lenses
D455 = {"width": 1280, "height": 800, "fx": 636.5, "fy": 635.9, "cx": 644.4, "cy": 407.8}


def unfolded(coeffs: tuple[float, ...]) -> bool:
    """Return whether radii grow towards the corners of the image; a fold could not be undone."""
    r = np.linspace(0, 1.6, 60)
    slope = 1 + 3 * coeffs[0] * r**2 + 5 * coeffs[1] * r**4 + 7 * coeffs[4] * r**6
    reached = r * (1 + coeffs[0] * r**2 + coeffs[1] * r**4 + coeffs[4] * r**6)
    return bool(slope[: np.argmax(reached > 1.25)].min(initial=1) > 0.4 and reached.max() > 1.25)


TANGENTIAL = st.floats(-2e-3, 2e-3)
COEFFS = st.tuples(
    st.floats(-0.08, 0.08), st.floats(-0.08, 0.08), TANGENTIAL, TANGENTIAL, st.floats(-0.03, 0.03)
).filter(unfolded)


def lens(model: Any, coeffs: Any) -> Intrinsics:
    """Return a lens, without the coefficients if it is a pinhole."""
    return Intrinsics(**D455, model=model, coeffs=coeffs if model != "pinhole" else (0,) * 5)


def grid(intrinsics: Intrinsics) -> np.ndarray:
    u, v = np.meshgrid(np.linspace(0, intrinsics.width - 1, 9), np.linspace(0, intrinsics.height - 1, 7))
    return np.stack([u.ravel(), v.ravel()], axis=1)


@pytest.mark.parametrize("model", MODELS)
@given(coeffs=COEFFS, z=st.floats(0.1, 10))
def test_a_pixel_lifted_and_projected_is_itself(model, coeffs, z):
    camera = lens(model, coeffs)
    pixels = grid(camera)
    points = camera.deproject(pixels, np.full(len(pixels), z))
    np.testing.assert_allclose(points[:, 2], z)
    np.testing.assert_allclose(camera.project(points), pixels, atol=1e-5)


@given(coeffs=COEFFS)
def test_brown_conrady_is_opencvs(coeffs):
    camera = Intrinsics(**D455, model="brown_conrady", coeffs=coeffs)
    pixels = grid(camera)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
    undistort = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)  # OpenCV 4 has two, 5 one with both signatures
    ideal = undistort(pixels, camera.matrix, np.array(coeffs), R=None, P=None, criteria=criteria)
    rays = camera.rays(pixels)
    np.testing.assert_allclose(rays[:, :2], np.asarray(ideal).reshape(-1, 2), atol=1e-6)
    projected = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.matrix, np.array(coeffs))[0]
    np.testing.assert_allclose(camera.project(rays), np.asarray(projected).reshape(-1, 2), atol=1e-6)


@pytest.fixture(scope="module")
def realsense() -> Any:
    try:
        import libusb_package
    except ImportError:
        pass
    else:
        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    return pytest.importorskip("pyrealsense2", exc_type=ImportError)


@pytest.mark.parametrize(
    ("model", "theirs"),
    [*zip(MODELS, ("none", *MODELS[1:]), strict=True)],
)
def test_librealsense_agrees(realsense, model, theirs):
    coeffs = (-0.056, 0.067, 4e-4, -6e-4, -0.021)  # a D455's, as its firmware reports them
    raw = realsense.intrinsics()
    raw.width, raw.height, raw.fx, raw.fy, raw.ppx, raw.ppy = 1280, 800, 636.5, 635.9, 644.4, 407.8
    raw.model, raw.coeffs = getattr(realsense.distortion, theirs), list(coeffs)
    camera = CameraModel(raw).intrinsics
    assert camera.model == model
    pixels = grid(camera)
    lifted = np.array([realsense.rs2_deproject_pixel_to_point(raw, pixel, 0.7) for pixel in pixels.tolist()])
    np.testing.assert_allclose(camera.deproject(pixels, np.full(len(pixels), 0.7)), lifted, atol=2e-5)  # it stops early
    points = camera.deproject(pixels, np.full(len(pixels), 0.7))
    projected = np.array([realsense.rs2_project_point_to_pixel(raw, point) for point in points.tolist()])
    np.testing.assert_allclose(camera.project(points), projected, atol=2e-3)  # it counts in single precision


K, D = np.array([[600.0, 0, 319.0], [0, 601.0, 242.0], [0, 0, 1]]), np.array([[0.1, 0.01, 1e-3, 2e-3, 0.0]])
PINHOLE = Intrinsics(640, 480, 600.0, 601.0, 319.0, 242.0)
BENT = Intrinsics(640, 480, 600.0, 601.0, 319.0, 242.0, "brown_conrady", tuple(D[0]))
SIZE = {"width": 640, "height": 480}
REALSENSE = {**SIZE, "fx": 600.0, "fy": 601.0, "ppx": 319.0, "ppy": 242.0, "coeffs": D[0].tolist()}


@pytest.mark.parametrize(
    ("camera", "expected"),
    [
        (K, PINHOLE),
        ((K, D), BENT),
        ([K.tolist(), D[0, :4].tolist()], BENT),
        ((K, None, (640, 480)), PINHOLE),
        (SimpleNamespace(**SIZE, k=K.ravel(), d=[*D[0], 0, 0, 0], distortion_model="rational_polynomial"), BENT),
        ({**SIZE, "K": K.ravel().tolist(), "D": D[0].tolist(), "distortion_model": "plumb_bob"}, BENT),
        ({"camera_matrix": {"rows": 3, "cols": 3, "data": K.ravel().tolist()}, "image_width": 640,
          "image_height": 480, "distortion_coefficients": {"data": D[0].tolist()}}, BENT),
        (SimpleNamespace(**SIZE, intrinsic_matrix=K), PINHOLE),  # Open3D's
        *[({**SIZE, "camera_matrix": K, name: D}, BENT) for name in ("dist_coeff", "dist", "distCoeffs", "distortion")],
        (K + [[0, 1e-5, 0], [0, 0, 0], [0, 0, 0]], PINHOLE),
        ({**REALSENSE, "model": "Brown Conrady"}, BENT),
        (SimpleNamespace(**REALSENSE, model="distortion.none"), PINHOLE),
        (SimpleNamespace(get_intrinsics=lambda: SimpleNamespace(**REALSENSE, model="distortion.none")), PINHOLE),
        ({"intrinsics": PINHOLE.to_dict(), "transform_camera_to_base": np.eye(4).tolist()}, PINHOLE),
    ],
)  # fmt: skip
def test_cameras_of_other_libraries_are_read_wherever_one_is_given(camera, expected):
    made = as_camera_model(camera, (480, 640))
    assert made is not None
    assert made.intrinsics == expected
    mask, depth = np.zeros((480, 640), np.uint8), np.full((480, 640), 0.7, np.float32)
    mask[100:110, 50:600] = 1
    for one in (camera, expected):
        points = ShapeDetector().detect_mask(mask, depth, one).shapes[0].points3d
        assert points is not None
        np.testing.assert_allclose(expected.project(points)[:, 1], 104.5, atol=0.6)


def test_sources_calibration_and_features_take_them_too():
    lens = SimpleNamespace(**REALSENSE, model="distortion.none")
    assert WebcamSource("0", intrinsics=lens).lens == PINHOLE
    assert Registration(lens, lens, np.eye(3), (0.059, 0, 0)).output == PINHOLE
    assert Extrinsics(T=tuple(map(tuple, np.eye(4).tolist()))).camera(lens).intrinsics == PINHOLE
    context = FeatureContext(640, 480, lens)  # type: ignore[arg-type]
    assert context.camera == CameraModel(PINHOLE)
    corners = np.array([(300.0, 200.0), (340.0, 200.0), (340.0, 240.0), (300.0, 240.0)])
    seen, expected = (marker_points(corners, each, size=0.05) for each in (lens, PINHOLE))
    np.testing.assert_array_equal(seen, expected)


@pytest.mark.parametrize(
    ("camera", "hint"),
    [
        (K.T, "expected K as"),
        (2 * K, "expected K as"),
        (np.zeros((3, 3)), "not calibrated"),
        (np.eye(4), "3 x 3"),
        (np.diag([2.0, 2, 1]) @ K, "another size"),
        ((K, [0.1, 0, 0, 0, 0, 0.2, 0, 0]), "rectify the image"),
        ({**SIZE, "k": K.ravel(), "d": D[0, :4], "distortion_model": "equidistant"}, "rectify the image"),
        ({**SIZE, "k": K.ravel(), "d": [], "binning_x": 2}, "binning"),
        (REALSENSE, "give both"),
        (SimpleNamespace(**REALSENSE), "give both"),
        ({**REALSENSE, "model": "brown_conrady", "coeffs": None}, "give both"),
        *[({**SIZE, "K": K, name: D}, f"{name!r} next to K") for name in ("coeffs", "Distort", "dist_coefs")],
        ({**SIZE, "K": K, "distortion": {"k1": 0.1}}, "numbers as D"),
        (SimpleNamespace(**SIZE, K=K, coeffs=D), "'coeffs' next to K"),
        (K + [[0, 0.1, 0], [0, 0, 0], [0, 0, 0]], "expected K as"),
        ({**REALSENSE, "model": "none", "cx": 320.0}, "cx is 320.0 and ppx 319.0"),
        ({**REALSENSE, "model": "distortion.kannala_brandt4"}, "lens model is 'kannala_brandt4'"),
        ({"intrinsics": PINHOLE, "transform": np.eye(4)}, "did you mean 'transform_camera_to_base'"),
        ({**SIZE, "fx": 600.0}, "missing fy"),
    ],
)
def test_what_describes_no_camera_that_can_be_used_is_refused(camera, hint):
    with pytest.raises(ValueError, match=hint):
        as_camera_model(camera, (480, 640))


@pytest.mark.parametrize("model", MODELS)
def test_unknown_depth_and_pixels_stay_unknown(model):
    camera = lens(model, (0.01, 0, 0, 0, 0))
    points = camera.deproject([[10.0, 10.0], [np.nan, 1.0], [20.0, 20.0]], [np.nan, 1.0, 1.0])
    assert np.isnan(points[:2]).any(axis=1).all()
    np.testing.assert_allclose(camera.project(points[2]), [20, 20], atol=1e-6)


@given(
    turn=st.tuples(*[st.floats(-3, 3)] * 3),
    shift=st.tuples(*[st.floats(-2, 2)] * 3),
    point=st.tuples(*[st.floats(-3, 3)] * 3),
)
def test_base_and_camera_frame_are_inverse(turn, shift, point):
    transform = np.eye(4)
    transform[:3, :3] = cv2.Rodrigues(np.array(turn))[0]
    transform[:3, 3] = shift
    camera = CameraModel(Intrinsics(**D455), transform)
    np.testing.assert_allclose(camera.to_base(point), (transform @ [*point, 1])[:3], atol=1e-9)
    np.testing.assert_allclose(camera.from_base(camera.to_base(point)), point, atol=1e-9)


def test_the_pose_is_a_copy_that_cannot_be_written():
    given_pose = np.eye(4)
    camera = CameraModel(Intrinsics(**D455), given_pose)
    given_pose[0, 3] = 5.0
    assert camera.transform_camera_to_base is not None
    assert camera.transform_camera_to_base[0, 3] == 0
    with pytest.raises(ValueError, match="read-only"):
        camera.transform_camera_to_base[0, 3] = 1.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fx": 0.0}, "fx and fy must lie in 0.001...1e.09 pixels, got 0.0 and 635.9"),
        ({"cx": float("nan")}, "cx and cy must lie in .-1e.09 pixels, got nan and 407.8"),
        ({"width": 0}, "width and height must be positive, got 0 x 800"),
        ({"coeffs": (0.1, 0.2)}, r"coeffs must be five numbers \(k1, k2, p1, p2, k3\) in .-1e.06, got \(0.1, 0.2\)"),
        ({"coeffs": (0.1, 0, 0, 0, 0)}, "a pinhole has no distortion, but coeffs are .*add model='brown_conrady'"),
        ({"model": "brown_conradi"}, "unknown value 'brown_conradi'; did you mean 'brown_conrady'"),
    ],
)
def test_wrong_intrinsics_are_reported(change, message):
    with pytest.raises(ValueError, match=message):
        Intrinsics(**{**D455, **change})


@pytest.mark.parametrize(
    ("pose", "fault"),
    [
        (np.eye(3), r"shape \(3, 3\)"),
        (np.diag([2.0, 2, 2, 1]), "off by 3"),
        (np.diag([1, 1.0005, 1, 1]), "off by 0.001; .*more digits"),
        (np.diag([1.0, 1, -1, 1]), "mirrored"),
        (np.full((4, 4), np.nan), "NaN"),
        (np.eye(4)[[0, 1, 3, 2]], "last row"),
    ],
)
def test_a_pose_that_is_not_rigid_is_refused(pose, fault):
    with pytest.raises(ValueError, match=rf"transform_camera_to_base must be a rigid \(4,4\) transform .*{fault}"):
        CameraModel(Intrinsics(**D455), pose)


def test_wrong_shapes_are_reported():
    with pytest.raises(ValueError, match=r"points: expected shape \(..., 3\), got \(4, 2\)"):
        Intrinsics(**D455).project(np.zeros((4, 2)))
    with pytest.raises(ValueError, match=r"pixels: expected shape \(..., 2\), got \(\)"):
        Intrinsics(**D455).rays(1.0)


def test_the_noise_of_stereo_depth_grows_with_the_square_of_the_depth():
    # 0.08 px of disparity, a focal length of 386 px and a baseline of 95 mm: 0.55 mm at 0.5 m, 4.91 mm at 1.5 m.
    np.testing.assert_allclose(DepthNoise().sigma([0.5, 1.5], focal=386.0), [5.454e-4, 4.9087e-3], rtol=1e-3)
    for arguments in ({"disparity": -0.1}, {"baseline": 0.0}, {"baseline": np.inf}):
        with pytest.raises(ValueError, match="DepthNoise"):
            DepthNoise(**arguments)
    with pytest.raises(ValueError, match="focal"):
        DepthNoise().sigma(1.0, focal=0.0)
