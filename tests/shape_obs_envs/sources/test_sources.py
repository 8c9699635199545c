"""Sources other than cameras, and opening a source from a string."""

from __future__ import annotations

import re
import sys
from textwrap import dedent
from typing import Any

import cv2
import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.wrappers import Autoreset, RepeatAction

from shape_obs import CameraModel, Intrinsics
from shape_obs.extrinsics import Extrinsics
from shape_obs.recording import record
from shape_obs.recording.format import read_moments
from shape_obs.source import BadRecording, CameraNotFound, EndOfSource, NotConnected, RGBDSource, SourceError
from shape_obs_envs.sources import EnvSource, FolderSource, VideoSource, open_source
from shape_obs_envs.sources.env import zero_action
from shape_obs_envs.sources.photo import PhotoSource


class Clock(gym.Env):
    """Episodes of three steps whose images show their number, drawn into one reused buffer."""

    metadata = {"render_fps": 20}  # noqa: RUF012
    action_space = spaces.Box(0.5, 1.0, (2,), np.float32)

    def __init__(self, stamped=False):
        images = {
            "rgb": spaces.Box(0, 255, (24, 32, 3), np.uint8),
            "depth": spaces.Box(0, 9, (24, 32), np.uint16),
        }
        self.observation_space = spaces.Dict(images)
        self.count, self.stamped, self.actions, self.seeds = 0, stamped, [], []
        self.buffers = {key: np.zeros(space.shape, space.dtype) for key, space in images.items()}
        self.camera_model = CameraModel(Intrinsics(32, 24, 40.0, 40.0, 15.5, 11.5), np.eye(4))

    def _observe(self):
        for buffer in self.buffers.values():
            buffer[...] = self.count
        self.count += 1
        return self.buffers, {"stamp": 100.0 + self.count} if self.stamped else {}

    @property
    def anchors(self):
        return {"hand": (0.1 * self.count, 0.0, 1.0)}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.seeds.append(seed)
        return self._observe()

    def step(self, action):
        self.actions.append(action)
        self.steps += 1
        observation, info = self._observe()
        return observation, 0.0, False, self.steps == 3, info


@pytest.fixture
def photos(tmp_path):
    """Return a folder of photos 2, 10 and 1 with one gray value each, and a file that is no photo."""
    folder = tmp_path / "photos"
    folder.mkdir()
    for number in (2, 10, 1):
        cv2.imwrite(str(folder / f"shot{number}.png"), np.full((20, 30, 3), (0, 0, number), np.uint8))
    (folder / "notes.txt").write_text("no photo")
    return folder


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """Return a video of eight frames at 25 Hz, each with one brightness."""
    path = tmp_path_factory.mktemp("video") / "gray.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (64, 48))
    assert writer.isOpened()
    for i in range(8):
        writer.write(np.full((48, 64, 3), 20 * i, np.uint8))
    writer.release()
    return path


def rest(source):
    """Return all remaining frames."""
    frames: list[Any] = [moment.frame for moment in read_moments(source)]
    with pytest.raises(EndOfSource, match=f"end of its {len(frames)} frames"):
        source.read()
    return frames


# ---- what every source promises


@pytest.mark.parametrize("kind", ["photos", "recording", "video", "env"])
def test_every_source_keeps_the_protocol(kind, photos, video, tmp_path):
    source: RGBDSource
    if kind == "photos":
        source = FolderSource(photos)
    elif kind == "video":
        source = VideoSource(video)
    elif kind == "env":
        source = EnvSource(Clock())
    else:
        with EnvSource(Clock()) as env:
            record(env, tmp_path / "recording", frames=3)
        source = FolderSource(tmp_path / "recording")
    with pytest.raises(NotConnected, match=re.escape(source.name)):
        source.read()
    with pytest.raises(NotConnected):
        _ = source.intrinsics
    with source:
        assert isinstance(source, RGBDSource)
        source.connect()
        assert source.kind == ("folder" if kind in ("photos", "recording") else kind)
        assert not source.live
        frames: list[Any] = [source.read(), source.read_latest(), source.read(fresh=True)]
        first, second, third = frames
        assert [frame.number for frame in (first, second, third)] == [0, 1, 2]
        assert first.rgb is not None
        assert (first.depth is not None) == source.has_depth
        assert (source.intrinsics is None) == (source.camera is None) == (first.camera is None)
        kept = first.rgb.copy()
        assert not np.array_equal(third.rgb, kept)
        assert np.array_equal(first.rgb, kept)
    with pytest.raises(NotConnected):
        source.read()
    source.disconnect()
    with source:
        again: Any = source.read()
        assert again.number == 0
        if kind != "env":  # which goes on where it was, since it is ours
            assert np.array_equal(again.rgb, kept)


# ---- photos


def test_one_photo_with_its_depth_is_a_source_of_one_frame(photos, tmp_path):
    np.save(tmp_path / "depth.npy", np.full((20, 30), 0.5, np.float32))
    source = PhotoSource(photos / "shot2.png", depth=tmp_path / "depth.npy", intrinsics=(30.0, 30.0, 14.5, 9.5))
    for _ in range(2):
        with source:
            frame: Any = source.read()
            assert (frame.number, frame.camera.intrinsics.size, source.has_depth) == (0, (20, 30), True)
            np.testing.assert_array_equal(frame.depth, np.float32(0.5))
            with pytest.raises(EndOfSource):
                source.read()
    with pytest.raises(BadRecording), PhotoSource(photos / "notes.txt"):
        pass


def test_photos_come_in_the_order_of_their_numbers(photos):
    with FolderSource(photos) as source:
        assert len(source) == 3
        frames = rest(source)
    assert [int(frame.rgb[0, 0, 0]) for frame in frames] == [1, 2, 10]
    assert all(frame.stamp is None and frame.depth is None and frame.camera is None for frame in frames)


def test_a_part_of_a_folder_is_read_as_all_of_it_is(photos, tmp_path):
    with EnvSource(Clock()) as env:
        record(env, tmp_path / "recording", frames=3)
    for folder in (photos, tmp_path / "recording"):
        with FolderSource(folder) as source:
            whole = rest(source)
        for _ in range(2):  # the second time its lines are known
            with FolderSource(folder, frames=(1, 2)) as part:
                assert len(part) == 2
                found = rest(part)
            assert [frame.number for frame in found] == [1, 2]
            assert all(np.array_equal(mine.rgb, its.rgb) for mine, its in zip(found, whole[1:], strict=True))
        with (
            pytest.raises(BadRecording, match=r"2 \.\.\. 3 were requested, there are 3"),
            FolderSource(folder, frames=(2, 2)),
        ):
            pass
    with pytest.raises(ValueError, match=r"frames: expected \(first, count\)"):
        FolderSource(photos, frames=(-1, 2))


# ---- videos


def test_video_frames_carry_the_times_they_are_shown_at(video):
    with VideoSource(video) as source:
        frames = rest(source)
    assert len(frames) == 8
    assert np.allclose([frame.stamp for frame in frames], np.arange(8) / 25, atol=1e-3)
    assert np.allclose([frame.rgb.mean() for frame in frames], 20 * np.arange(8), atol=3)


# ---- environments


def test_an_environment_steps_and_starts_again():
    env = Clock()
    with EnvSource(env, seed=5) as source:
        frames: list[Any] = []
        episodes, anchors = [], []
        for _ in range(9):
            frames.append(source.read())
            episodes.append(source.episode)
            anchors.append(source.anchors["hand"][0])
    assert [int(frame.rgb[0, 0, 0]) for frame in frames] == list(range(9)), "the first frame shows the reset"
    assert [int(frame.depth[0, 0]) for frame in frames] == list(range(9))
    assert episodes == [0, 0, 0, 0, 1, 1, 1, 1, 2]
    assert env.seeds == [5, None, None]
    assert np.allclose([frame.stamp for frame in frames], np.arange(9) / 20), "time goes on over resets"
    assert np.allclose(anchors, 0.1 * np.arange(1, 10))
    assert np.allclose(env.actions, 0.5), "the action nearest to none"


def test_stamps_of_the_environment_win():
    with EnvSource(Clock(stamped=True)) as source:
        assert [source.read().stamp for _ in range(3)] == [101.0, 102.0, 103.0]


def test_wrappers_that_reset_or_repeat_leave_episodes_and_time_right():
    for wrap, stamps in ((Autoreset, 0.05), (lambda env: RepeatAction(env, 3), 0.15)):
        with EnvSource(wrap(Clock())) as source:
            seen = [(source.read().stamp, source.episode, source.transition.step) for _ in range(5)]  # type: ignore[union-attr]
        steps = 4 if wrap is Autoreset else 2
        assert seen == [(pytest.approx(i * stamps), i // steps, i % steps) for i in range(5)]


def test_actions_are_random_by_seed_or_a_policys():
    drawn = []
    for _ in range(2):
        env = Clock()
        with EnvSource(env, actions="random", seed=3) as source:
            for _ in range(4):
                source.read()
        drawn.append(env.actions)
    assert np.array_equal(drawn[0], drawn[1])
    assert np.ptp(drawn[0]) > 0
    env = Clock()
    with EnvSource(env, actions=lambda seen: np.full(2, 0.5 + 0.1 * seen["rgb"][0, 0, 0], np.float32)) as source:
        for _ in range(4):
            source.read()
    assert np.allclose([action[0] for action in env.actions], [0.5, 0.6, 0.7])
    with pytest.raises(ValueError, match="actions: expected 'zero', 'random' or a function, got 'none'"):
        EnvSource(Clock(), actions="none")  # pyright: ignore[reportArgumentType]


def test_the_zero_action_lies_in_every_space():
    space = spaces.Dict(
        {
            "box": spaces.Box(0.5, 1.0, (2,)),
            "one": spaces.Discrete(4, start=-1),
            "many": spaces.Tuple([spaces.MultiDiscrete([3, 2]), spaces.MultiBinary(4)]),
        }
    )
    assert space.contains(zero_action(space))
    with pytest.raises(ValueError, match="give actions='random', or a function"):
        zero_action(spaces.Text(3))


def test_extrinsics_of_the_user_win(tmp_path):
    place = Extrinsics(T=((-1, 0, 0, 0), (0, -1, 0, 0), (0, 0, 1, 2), (0, 0, 0, 1)))
    place.save(tmp_path / "place.json")
    for given in (place, tmp_path / "place.json"):
        with EnvSource(Clock(), given) as source:
            frame = source.read()
        assert frame.camera is not None
        assert np.array_equal(np.array(frame.camera.transform_camera_to_base), place.matrix)
    with EnvSource(Clock(), place) as source:
        record(source, tmp_path / "r", frames=2)
    for given, where in ((None, place.matrix), (Extrinsics(T=tuple(map(tuple, np.eye(4).tolist()))), np.eye(4))):
        with FolderSource(tmp_path / "r", given) as source:
            frame = source.read()
            assert source.camera is not None
            assert np.array_equal(np.array(source.camera.transform_camera_to_base), where)
        assert frame.camera is not None
        assert np.array_equal(np.array(frame.camera.transform_camera_to_base), where)


# ---- opening


def test_a_word_opens_what_it_names(photos, video, monkeypatch):
    assert isinstance(open_source(str(video)), VideoSource)
    for word in ("ShapeObs/Cable-v0", "shape_obs_envs:ShapeObs/Cable-v0", "their_module:TheirEnv-v1", "a.b:Env-v0"):
        source = open_source(word, actions="random", seed=1)
        assert isinstance(source, EnvSource)
        assert source.name == word
    (photos / "webcam").mkdir()  # a folder with the name of a camera
    monkeypatch.chdir(photos)
    for word in (photos, "webcam"):
        assert isinstance(open_source(word), FolderSource)


@pytest.mark.parametrize(
    ("word", "options", "error", "message"),
    [
        ("none/at/all", {}, BadRecording, "none/at/all: no such file or folder"),
        ("notes.txt", {}, BadRecording, "expected .db3, .bag, .mcap, .mp4, .* or a folder, got '.txt'"),
        ("shot1.png", {}, BadRecording, "or a folder, got '.png'; for photos give the folder that contains them"),
        ("d45", {}, CameraNotFound, "'d45' is not a camera, path, class or environment; did you mean 'd4"),
        ("ShapeObs/Cabel-v0", {}, SourceError, "not registered.*did you mean 'ShapeObs/Cable-v0'"),
        ("no_such_module:Some-v0", {}, SourceError, "no_such_module"),
        ("CartPole-v1", {}, SourceError, r"CartPole-v1: the observation must be an RGB image"),
        ("broken", {}, BadRecording, r"shot2\.png: not an image that can be read"),
        ("empty", {}, BadRecording, r"expected a recording .* or images .*, found neither"),
        ("cut.avi", {}, BadRecording, r"cut\.avi: .*(not a video|holds no frame)"),
        (".", {"width": 640}, ValueError, "width are settings of a camera"),
        (".", {"exposure": 3}, ValueError, r"a FolderSource does not take \['exposure'\]"),
    ],
)
def test_what_cannot_be_read_gets_one_clear_line(word, options, error, message, photos, video, monkeypatch):
    monkeypatch.chdir(photos)
    for name in ("empty", "broken"):
        (photos / name).mkdir()
    (photos / "broken" / "shot2.png").write_bytes(b"this is no picture")
    (photos / "cut.avi").write_bytes(video.read_bytes()[:100])
    with pytest.raises(error, match=message) as caught, open_source(word, **options) as source:
        source.read()
    assert "\n" not in str(caught.value)


# ---- classes of the user

CAMERA = """
    import time

    import numpy as np

    from shape_obs.frame import Frame
    from shape_obs.source import EndOfSource, Source


    class Counter(Source):
        kind, name, live, has_depth, intrinsics = "counter", "counter", False, False, None

        def __init__(self, first=0, frames=5, extrinsics=None, width=30):
            super().__init__(extrinsics)
            self.first, self.frames, self.width = first, frames, width

        def connect(self):
            self.number = 0

        def disconnect(self):
            pass

        def read(self, timeout=1.0, fresh=False):
            if self.number == self.frames:
                raise EndOfSource("counted")
            value, self.number = self.first + self.number, self.number + 1
            rgb = np.full((20, self.width, 3), value, np.uint8)
            return Frame(rgb, stamp=value / 10, received=time.monotonic(), number=self.number - 1)

        def read_latest(self, max_age=0.1):
            return self.read()


    class Half:
        kind, name, live = "half", "half", True

        def connect(self):
            pass

        def read(self, timeout=1.0, fresh=False):
            raise AssertionError("the check must not read")


    class Wrong(Counter):
        def read(self, timeout=1.0, fresh=False):
            return super().read().rgb


    number = 3
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Write a module with cameras, and return its name."""
    (tmp_path / "their_camera.py").write_text(dedent(CAMERA))
    monkeypatch.syspath_prepend(str(tmp_path))
    yield "their_camera"
    sys.modules.pop("their_camera", None)


@pytest.mark.parametrize(
    ("name", "arguments", "error", "message"),
    [
        (
            "Half",
            {},
            TypeError,
            r"source their_camera:Half: expected .*RGBDSource .*, Half has no has_depth, intrinsics, camera, "
            r"read_latest\(\), disconnect\(\), __enter__\(\), __exit__\(\)\. Subclass .*LiveSource",
        ),
        ("number", {}, ValueError, "their_camera:number is a int, expected a class or a function"),
        ("Counter", {"speed": 3}, ValueError, "their_camera:Counter does not take {'speed': 3}"),
        ("Countr", {}, ValueError, "has no 'Countr'; did you mean 'Counter'"),
    ],
)
def test_a_class_that_is_no_source_says_what_is_missing(name, arguments, error, message, module):
    with pytest.raises(error, match=message) as caught:
        open_source(f"{module}:{name}", **arguments)
    assert "\n" not in str(caught.value)


def test_a_module_in_this_folder_that_python_does_not_find_says_so(tmp_path, monkeypatch):
    (tmp_path / "lost_camera.py").write_text("class Camera: pass")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry not in ("", str(tmp_path))])
    with pytest.raises(
        ImportError, match=r"cannot import 'lost_camera'.*lost_camera\.py is in this folder.*PYTHONPATH"
    ):
        open_source("lost_camera:Camera")
    with pytest.raises(ImportError, match="cannot import 'no_such_camera': No module named") as caught:
        open_source("no_such_camera:Camera")
    assert "PYTHONPATH" not in str(caught.value)


def test_a_class_is_recorded(module, run, tmp_path):
    word = f"{module}:Counter"
    code, _, err = run("record", "--source", word, "--set", "first=50", "frames=4", "-o", tmp_path / "four")
    assert code == 0, err
    with open_source(tmp_path / "four") as source:
        frames = [source.read() for _ in range(4)]
    assert [int(np.asarray(frame.rgb)[0, 0, 0]) for frame in frames] == [50, 51, 52, 53]
    assert [frame.stamp for frame in frames] == pytest.approx([5.0, 5.1, 5.2, 5.3])
    code, _, err = run("record", "--source", f"{module}:Wrong", "-o", tmp_path / "wrong")
    assert (code, "counter: read() returned a ndarray, expected a shape_obs.Frame" in err) == (1, True)
    with pytest.raises(BadRecording):
        open_source("none.mcap")
