"""Topics are found by what they contain; names decide only between several."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rosbags")

from ros_bags import FRAME, TYPES, camera_info, compressed, header, image, write_bag

from shape_obs.source import BadRecording
from shape_obs_envs.sources import RosbagSource

SIZE = (24, 32)
RGB, DEPTH = np.full((*SIZE, 3), 90, np.uint8), np.full(SIZE, 700, np.uint16)
INFO = camera_info(SIZE, (30.0, 30.0, 15.5, 11.5))
OTHER = "camera_depth_optical_frame"


def colour(frame: str = FRAME):
    return image(RGB, "rgb8", 1.0, frame)


def gray(frame: str = FRAME):
    return image(RGB[..., 0], "mono8", 1.0, frame)


def depth(frame: str = FRAME, shape: tuple[int, int] = SIZE):
    return image(np.full(shape, 700, np.uint16), "16UC1", 1.0, frame)


def metres(frame: str = FRAME):
    return image(np.full(SIZE, 0.7, np.float32), "32FC1", 1.0, frame)


def imu():
    vector, turn = TYPES["geometry_msgs/msg/Vector3"](0.0, 0.0, 9.81), TYPES["geometry_msgs/msg/Quaternion"](0, 0, 0, 1)
    return TYPES["sensor_msgs/msg/Imu"](header(1.0), turn, np.zeros(9), vector, np.zeros(9), vector, np.zeros(9))


def unreadable():
    return image(RGB.astype(np.uint16), "rgb16", 1.0)


# driver -> what it publishes, and the topics of colour, depth and intrinsics that must be found
DRIVERS = {
    "realsense": (
        {
            "/camera/camera/color/image_raw": colour(),
            "/camera/camera/color/camera_info": INFO,
            "/camera/camera/depth/image_rect_raw": depth(OTHER, (30, 40)),
            "/camera/camera/depth/camera_info": camera_info((30, 40), (30.0, 30.0, 20.0, 15.0), frame=OTHER),
            "/camera/camera/aligned_depth_to_color/image_raw": depth(),
            "/camera/camera/aligned_depth_to_color/camera_info": INFO,
            "/camera/camera/infra1/image_rect_raw": gray(OTHER),
        },
        ("/camera/camera/color/image_raw", "/camera/camera/aligned_depth_to_color/image_raw"),
        "/camera/camera/color/camera_info",
    ),
    "zed": (
        {
            "/zed/zed_node/rgb/image_rect_color": colour("zed_left"),
            "/zed/zed_node/rgb/camera_info": INFO,
            "/zed/zed_node/left/image_rect_color": colour("zed_left"),
            "/zed/zed_node/right/image_rect_color": colour("zed_right"),
            "/zed/zed_node/depth/depth_registered": metres("zed_left"),
            "/zed/zed_node/depth/camera_info": INFO,
        },
        ("/zed/zed_node/rgb/image_rect_color", "/zed/zed_node/depth/depth_registered"),
        "/zed/zed_node/rgb/camera_info",
    ),
    "an IMU and what another node drew": (
        {"/imu": imu(), "/overlay": image(RGB, "8UC3", 1.0), "/color/image_raw": colour(), "/far/image": unreadable()},
        ("/color/image_raw", None),
        None,
    ),
    "one usb camera": ({"/image_raw": colour(), "/camera_info": INFO}, ("/image_raw", None), "/camera_info"),
    "a gray camera": ({"/eye/image": gray()}, ("/eye/image", None), None),
    "info elsewhere": (
        {"/eye": colour("a"), "/lens": camera_info(SIZE, (9, 9, 9, 9), frame="a")},
        ("/eye", None),
        "/lens",
    ),
}


def write(folder, messages):
    return write_bag(folder / "bag", [(topic, 1.0, message) for topic, message in messages.items()]).parent


@pytest.mark.parametrize("driver", DRIVERS)
def test_the_topics_of_a_driver_are_found(driver, tmp_path, recwarn):
    messages, (wanted, wanted_depth), wanted_info = DRIVERS[driver]
    with RosbagSource(write(tmp_path, messages)) as source:
        found = source.topics
        assert (found.colour.topic, found.depth and found.depth.topic) == (wanted, wanted_depth)
        assert found.info == wanted_info
        assert source.has_depth == (wanted_depth is not None)
        assert (source.intrinsics is None) == (wanted_info is None)
        frame = source.read()
        assert (frame.depth is None) == (wanted_depth is None)
    assert not [str(each.message) for each in recwarn if "bag" in str(each.message)]


def test_depth_that_is_not_aligned_is_left_out_with_a_warning(tmp_path):
    bag = write(tmp_path, {"/color/image_raw": colour(), "/depth/image_raw": depth(OTHER)})
    source = RosbagSource(bag)
    with pytest.warns(UserWarning, match=r"/depth/image_raw is not aligned to /color.*align_depth.enable:=true"):
        source.connect()
    assert not source.has_depth
    assert source.read().depth is None
    source.disconnect()
    with (
        pytest.warns(UserWarning, match="taken as aligned"),
        pytest.warns(UserWarning, match="no camera_info"),
        RosbagSource(bag, depth="/depth/image_raw") as source,
    ):
        assert np.array_equal(np.asarray(source.read().depth), DEPTH)
    with RosbagSource(bag, depth=False) as source:  # asked for, so nothing is said
        assert not source.has_depth


ONE = {"/a/color/image_raw": colour("a"), "/b/color/image_raw": colour("b"), "/odometry": INFO}


@pytest.mark.parametrize(
    ("messages", "arguments", "expected"),
    [
        (
            {"/odometry": INFO, "/far": unreadable(), "/d": compressed(b"x" * 40, "16UC1; compressedDepth rvl", 1.0)},
            {},
            r"no topic with colour images; it has /d .*rvl.* not supported.*/far \(sensor_msgs/msg/Image, rgb16\)",
        ),
        ({"/far": unreadable()}, {"color": "/far"}, "the images in /far have the encoding rgb16; expected rgb8"),
        ({"/a": colour(), "/b": depth()}, {"color": "/b"}, "the images in /b have the encoding 16UC1; expected rgb8"),
        ({"/a": colour()}, {"depth": "/a"}, "the images in /a have the encoding rgb8; expected 16UC1"),
        ({"/odometry": INFO}, {}, r"no topic with colour images; it has /odometry \(sensor_msgs/msg/CameraInfo\)"),
        (ONE, {}, "several .*, /a/color/image_raw, /b/color/image_raw: choose one, --set color=/a/color/image_raw"),
        (
            ONE,
            {"color": "/a/colour/image_raw"},
            "color: no images in /a/colour.*did you mean '/a/color/image_raw'",
        ),
        (ONE, {"color": "/a/color/image_raw", "info": "/odometri"}, "info: no CameraInfo.*did you mean '/odometry'"),
        (
            {"/a/image": colour(), "/x/depth": depth(), "/y/depth": metres()},
            {},
            "several topics with depth aligned to /a/image, /x/depth, /y/depth: choose one, --set depth=/x/depth",
        ),
        (
            {"/a/image": colour(), "/a/camera_info": camera_info((48, 64), (60, 60, 32, 24))},
            {},
            "/a/camera_info describes images of 64 x 48 pixels, the colour image has 32 x 24",
        ),
        (
            {"/a/image": colour(), "/a/camera_info": camera_info(SIZE, (30, 30, 15, 12), binning=2)},
            {},
            "binning and regions of interest are not supported",
        ),
        (
            {"/a/image": colour(), "/a/camera_info": camera_info(SIZE, (30, 30, 15, 12), (0.1, 0.2), "fov")},
            {},
            "model 'fov' with 2 coefficients is not supported, expected plumb_bob.*image_proc",
        ),
    ],
)
def test_what_cannot_be_chosen_is_an_error_that_lists_the_topics(messages, arguments, expected, tmp_path):
    with pytest.raises(BadRecording, match=expected) as caught, RosbagSource(write(tmp_path, messages), **arguments):
        pass
    assert "\n" not in str(caught.value)


def test_channels_without_names_are_bgr_with_a_warning(tmp_path):
    bag = write(tmp_path, {"/image": image(RGB * np.array([1, 0, 0], np.uint8), "8UC3", 1.0)})
    for color in (None, "/image"):
        with (
            pytest.warns(UserWarning, match="/image does not name its channels"),
            RosbagSource(bag, color=color) as source,
        ):
            assert np.array_equal(np.asarray(source.read().rgb), RGB * (0, 0, 1))


def test_a_rectified_image_has_the_intrinsics_of_p_and_is_not_rectified_again(tmp_path):
    info = camera_info(SIZE, (30, 31, 15, 12), (-0.3, 0.1, 0, 0, 0), p=(25.0, 26.0, 14.0, 11.0))
    noise = np.random.default_rng(0).integers(0, 256, (*SIZE, 3), np.uint8)
    both = {"/c/image_rect": image(noise, "rgb8", 1.0), "/c/image_raw": colour(), "/c/camera_info": info}
    bag = write(tmp_path, both)
    with RosbagSource(bag) as source:
        assert source.topics.colour.topic == "/c/image_rect"
        frame = source.read()
        assert frame.camera is not None
        assert (frame.camera.intrinsics.fx, frame.camera.intrinsics.cy) == (25.0, 11.0)
        assert np.array_equal(np.asarray(frame.rgb), noise)
    with RosbagSource(bag, color="/c/image_raw") as source:
        assert source.intrinsics is not None
        assert (source.intrinsics.fx, source.intrinsics.distorted) == (30.0, False)


def test_an_uncalibrated_camera_has_no_intrinsics(tmp_path):
    messages = {"/c/image": colour(), "/c/camera_info": camera_info((0, 0), (0, 0, 0, 0))}
    with RosbagSource(write(tmp_path, messages)) as source:
        assert source.intrinsics is None
        assert source.read().camera is None
