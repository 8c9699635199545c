"""Registration: depth is aligned to colour, and nothing is invented."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

from shape_obs import CameraModel, Intrinsics
from shape_obs_envs.sources.realsense.driver import d455_geometry
from shape_obs_envs.sources.registration import DepthReprojection, RawImages, Registration
from tests.benchmarks.scenes.tabletop import rows_of_blocks, see

D455 = d455_geometry(640, 480, 0.001)
COLOUR, DEPTH, PLACE = D455.colour, D455.depth, (D455.rotation, D455.translation)
PINHOLE = replace(COLOUR, model="pinhole", coeffs=(0.0,) * 5)
SMALL = Intrinsics(160, 120, 97.0, 97.0, 80.5, 59.3)
ASIDE = (-0.059, 0.0, 0.0)


def plane(camera: Intrinsics, tilt: float, distance: float = 0.62) -> np.ndarray:
    """Return the depth in millimetres of a plane that is tilted about the vertical."""
    rays = camera.rays(np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1))
    normal = np.array([np.sin(tilt), 0, np.cos(tilt)])
    return np.rint(1000 * distance * normal[2] / (rays @ normal)).astype(np.uint16)


@pytest.mark.skipif(not find_spec("pyrealsense2"), reason="compares with librealsense; pyrealsense2 is not installed")
def test_depth_lies_under_colour_and_blocks_stand_where_they_are_unlike_without_rectification() -> None:
    from tests.benchmarks.calibration import registered

    ours, theirs = registered(0)

    assert len(ours.edges) > 1500
    assert len(ours.centres) == len(theirs.centres) == 12
    assert np.median(ours.edges) <= 0.6
    assert max(ours.edges) <= 1.5
    assert max(ours.centres) <= 2.5

    assert np.median(theirs.edges) > 2 * np.median(ours.edges)
    assert np.median(theirs.edges) > 1.0
    assert max(theirs.centres) > 4


@pytest.mark.parametrize("tilt", [0, 20, 40])
def test_a_surface_has_no_cracks(tilt: float) -> None:
    registration = Registration(COLOUR, DEPTH, *PLACE)
    aligned = registration.align(plane(DEPTH, np.radians(tilt)))
    inside = aligned[40:-40, 60:-100]  # what both cameras have in view
    assert (inside > 0).all()
    truth = plane(PINHOLE, np.radians(tilt))[40:-40, 60:-100]
    assert np.median(np.abs(np.diff(inside.astype(int) - truth))) <= 1


def test_the_nearest_counts_and_holes_stay_holes() -> None:
    registration = Registration(SMALL, SMALL, np.eye(3), ASIDE)
    depth = np.full((120, 160), 900, np.uint16)
    depth[40:80, 80:120] = 400  # a block before a wall
    depth[10:20, 60:80] = 0
    aligned = registration.align(depth)

    near, far = 97 * 0.059 / 0.4, 97 * 0.059 / 0.9  # how far the block and the wall move to the left
    block = aligned == 400
    columns = np.flatnonzero(block.any(axis=0))
    assert columns[0] == pytest.approx(80 - near, abs=1)
    assert columns[-1] == pytest.approx(119 - near, abs=1)
    assert block[40:80, columns[0] : columns[-1] + 1].all()  # nothing of the wall shines through
    assert 40 * len(columns) == block[40:80].sum()
    assert block.sum() <= 42 * len(columns)
    shadow = aligned[45:75, columns[-1] + 2 : int(119 - far)]  # neither camera saw what is right of the block
    assert shadow.shape[1] >= 5
    assert (shadow == 0).all()
    hole = aligned[11:19, int(62 - far) : int(78 - far)]
    assert (hole == 0).all()
    assert set(np.unique(aligned)) == {0, 400, 900}


def test_depth_is_that_of_the_colour_camera_in_millimetres() -> None:
    registration = Registration(SMALL, SMALL, np.eye(3), (-0.059, 0.0, 0.005), depth_unit=0.0001)
    aligned = registration.align(np.full((120, 160), 6000, np.uint16))
    assert set(np.unique(aligned)) == {0, 605}


def test_raw_images_come_back_as_what_they_were_made_of() -> None:
    camera = Intrinsics(640, 480, 386.0, 386.0, 319.5, 239.5)
    place = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.62], [0, 0, 0, 1]])
    blocks = rows_of_blocks(np.random.default_rng(1))
    rgb, metres = see(blocks, CameraModel(camera, place))
    raw_images = RawImages(camera, COLOUR, DEPTH, *PLACE)
    raw_rgb, raw_depth = raw_images(rgb, np.rint(1000 * metres).astype(np.uint16))
    _, from_metres = raw_images(rgb, metres.astype(np.float32))
    assert (np.abs(from_metres.astype(int) - raw_depth) > 1).mean() < 0.005  # but for a few pixels at edges
    back, depth = Registration(COLOUR, DEPTH, *PLACE)(raw_rgb, raw_depth)

    truth_rgb, truth = see(blocks, CameraModel(PINHOLE, place))
    inside = np.s_[20:-20, 50:-20]
    assert np.abs(back[inside].astype(int) - truth_rgb[inside]).mean() < 2
    known = depth[inside] > 0
    assert known.mean() > 0.95  # what blocks hide from the depth camera is lost, as it is for a real one
    off = np.abs(depth[inside][known] - 1000 * truth[inside][known])
    assert np.median(off) <= 1
    assert (off > 5).mean() < 0.02  # edges


def test_raw_images_leave_holes_and_take_no_nonsense() -> None:
    raw = RawImages(SMALL, SMALL, SMALL, np.eye(3), ASIDE)
    depth = np.full((120, 160), np.nan, np.float32)
    depth[0], depth[1] = np.inf, -1.0
    assert (raw(np.zeros((120, 160, 3), np.uint8), depth)[1] == 0).all()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"rotation": np.zeros((3, 3))}, "rotation matrix"),
        ({"rotation": np.eye(4)}, r"\(3,3\) rotation"),
        ({"rotation": np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])}, "turned against the colour camera by 90"),
        ({"translation": (np.nan, 0, 0)}, "finite translation"),
        ({"depth_unit": 0.0}, "depth_unit"),
    ],
)
def test_a_pose_that_is_none_is_refused(wrong: dict, message: str) -> None:
    arguments = {"rotation": np.eye(3), "translation": ASIDE, **wrong}
    with pytest.raises(ValueError, match=message):
        Registration(SMALL, SMALL, **arguments)


def test_images_of_another_size_or_type_are_refused() -> None:
    registration = Registration(SMALL, SMALL, np.eye(3), ASIDE)
    rgb, depth = np.zeros((120, 160, 3), np.uint8), np.zeros((120, 160), np.uint16)
    with pytest.raises(ValueError, match=r"colour_raw: expected \(120, 160, 3\) uint8"):
        registration(rgb[:60], depth)
    with pytest.raises(ValueError, match=r"depth_raw: expected \(120, 160\) uint16.*got \(120, 160\) float32"):
        registration(rgb, depth.astype(np.float32))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="DepthReprojection: expected a target without distortion"):
        DepthReprojection(DEPTH, COLOUR, *PLACE, 0.001)
    with pytest.raises(ValueError, match="depth: expected a pinhole"):
        RawImages(SMALL, SMALL, COLOUR, np.eye(3), ASIDE)
