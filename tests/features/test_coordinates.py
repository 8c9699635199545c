"""Origins of points: their centroid, the shape's anchor, or a named anchor."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from drawn_shapes import OVERHEAD, shape

from shape_obs import CameraModel
from shape_obs.features import FeatureContext, Points2D, Points2DNormalized, Points3D
from shape_obs.geometry.topology import Chain

GRIPPER, PIXEL = (0.1, 0.05, 0.0), (200.0, 80.0)
VIEW = FeatureContext(
    320,
    240,
    OVERHEAD,
    ((-0.5, -0.4, -0.1), (0.5, 0.4, 0.3)),
    anchor=(0.2, 0.0, 0.0),
    anchors={"gripper1": GRIPPER, "mark": PIXEL},
)
NOWHERE = replace(VIEW, camera=CameraModel(OVERHEAD.intrinsics))
# Pixels, and what lies under them one metre before the camera.
SEEN = np.array([[100.0, 50.0], [160.0, 120.0], [220.0, 70.0]])


def rope(unknown: Any = (), filled: Any = ()):
    seen = shape(OVERHEAD.intrinsics.deproject(SEEN, np.ones(3)), Chain(3), unknown, filled)
    pixels = SEEN.copy()
    pixels[list(unknown)] = np.nan
    return replace(seen, points2d=pixels)


def values(feature, seen=None, view=VIEW):
    return feature.compute(seen or rope(), view).reshape(3, -1)


@pytest.mark.parametrize("make", [Points2D, Points2DNormalized, Points3D])
class TestCentroid:
    def test_the_mean_is_zero(self, make):
        np.testing.assert_allclose(values(make(origin="centroid")).mean(axis=0), 0, atol=1e-6)
        np.testing.assert_allclose(np.diff(values(make(origin="centroid")), axis=0), np.diff(values(make()), axis=0))
        assert not make(origin="centroid").anchored

    def test_it_is_that_of_the_known_points(self, make):
        some = values(make(origin="centroid"), rope(unknown=[1]))
        assert np.isnan(some[1]).all()
        np.testing.assert_allclose(some[0], -some[2], atol=1e-6)
        assert np.isnan(values(make(origin="centroid"), rope(unknown=[0, 1, 2]))).all()


class TestAnchors:
    def test_in_pixels(self):
        place = OVERHEAD.project_from_base(np.array([GRIPPER]))[0]
        np.testing.assert_allclose(place, [189.5, 104.5])
        np.testing.assert_allclose(values(Points2D(origin="gripper1")), SEEN - place, atol=1e-6)
        np.testing.assert_allclose(values(Points2D(origin="mark")), SEEN - PIXEL)
        np.testing.assert_allclose(values(Points2D(origin="anchor")), SEEN - [219.5, 119.5], atol=1e-6)

    def test_in_metres(self):
        base = values(Points3D(frame="base"))
        np.testing.assert_allclose(values(Points3D(frame="base", origin="gripper1")), base - GRIPPER, atol=1e-6)
        np.testing.assert_allclose(values(Points3D(frame="base", origin="anchor")), values(Points3D(frame="anchor")))
        # The camera looks down from one metre: its y is the base's, mirrored.
        camera = values(Points3D()) - [0.1, -0.05, 1.0]
        np.testing.assert_allclose(values(Points3D(origin="gripper1")), camera, atol=1e-6)

    @pytest.mark.parametrize(
        ("feature", "view", "message"),
        [
            (Points2D(origin="griper1"), VIEW, "'points2d': no origin 'griper1'; did you mean 'gripper1'? Known: "),
            (Points3D(origin="anchr"), VIEW, "did you mean 'anchor'? Known: centroid, anchor, gripper1, mark"),
            (Points3D("base", origin="mark"), VIEW, "origin 'mark' is a pixel, but its points are in metres"),
            (Points2D(origin="anchor"), FeatureContext(320, 240), "relative to the anchor needs a shape anchored to"),
            (Points2D(origin="gripper1"), replace(VIEW, camera=None), "'points2d' needs a camera model"),
            (Points3D(origin="gripper1"), NOWHERE, "in frame 'base' needs transform_camera_to_base"),
        ],
    )
    def test_mistakes_raise_an_error(self, feature, view, message):
        with pytest.raises(ValueError, match=re.escape(message)):
            feature.compute(rope(), view)
