"""Replaying gives exactly the frames and shapes of the original."""

from __future__ import annotations

from typing import Any

import numpy as np
from noise_frames import equal
from recorded_cable import FRAMES, detector

import shape_obs
from shape_obs import ShapeDetector
from shape_obs.recording import Moment, ShapeLog, replay
from shape_obs.recording.format import read_moments
from shape_obs_envs.sources import FolderSource


def test_a_recording_gives_every_frame_back_to_the_bit(cable, recorded):
    with FolderSource(recorded) as source:
        assert source.recording is not None
        assert source.recording.warning == ""
        played = list(read_moments(source))
    assert len(played) == FRAMES
    assert {moment.episode for moment in played} == {0, 1}
    live: Any
    back: Any
    for live, back in zip(cable, played, strict=True):
        assert equal(live.frame.rgb, back.frame.rgb)
        assert equal(live.frame.depth, back.frame.depth)
        assert (live.frame.stamp, live.frame.number, live.episode) == (
            back.frame.stamp, back.frame.number, back.episode,
        )  # fmt: skip
        assert live.frame.camera.intrinsics == back.frame.camera.intrinsics
        assert equal(live.frame.camera.transform_camera_to_base, back.frame.camera.transform_camera_to_base)
        assert {name: tuple(point) for name, point in back.anchors.items()} == live.anchors


def test_replaying_finds_exactly_the_shapes_that_were_found_live(cable, recorded):
    finder, live = detector(), []
    for moment in cable:
        if moment.frame.number == 51:  # the environment's second episode
            finder.reset()
        frame = moment.frame
        live.append(finder.detect(frame.rgb, frame.depth, frame.camera, stamp=frame.stamp, anchors=moment.anchors))
    with FolderSource(recorded) as source:
        back = [detection for _, detection in replay(source, detector())]
    assert sum(detection["rope"].ok for detection in live) > 0.9 * FRAMES
    for one, other in zip(live, back, strict=True):
        assert one.stamp == other.stamp
        for a, b in zip(one, other, strict=True):
            assert (a.ok, a.age, a.quality, a.reason) == (b.ok, b.age, b.quality, b.reason)
            assert (a.track_id, a.new, a.length) == (b.track_id, b.new, b.length)
            for name in ("points2d", "points3d", "visible", "valid", "sigma"):
                assert equal(getattr(a, name), getattr(b, name)), name


def test_a_source_without_depth_leaves_out_points_in_space(blue):
    segmentation = {"kind": "hsv", "low": [90, 60, 30], "high": [130, 255, 255]}
    finder = ShapeDetector(["centerline"], segmentation)
    log = ShapeLog(finder)
    log.add(Moment(shape_obs.Frame(blue)), finder.detect(blue))
    table = log.table()
    assert "centerline/points3d" not in table.columns
    assert table["number"].tolist() == [-1]
    assert np.isnan(table["received"]).all()
