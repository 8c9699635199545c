"""The file with the pose of a camera."""

from __future__ import annotations

import json
import warnings
from datetime import datetime, timedelta, timezone

import cv2
import numpy as np
import pytest

from shape_obs import Extrinsics, HSVRange, Intrinsics, ShapeDetector, SpecError
from shape_obs.extrinsics import ExtrinsicsWarning

INTRINSICS = Intrinsics(640, 480, 386.0, 385.0, 321.0, 243.0)


def place() -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = cv2.Rodrigues(np.array([2.0, 0.3, -0.4]))[0]
    matrix[:3, 3] = 0.4, -0.1, 0.8
    return matrix


def extrinsics(**fields) -> Extrinsics:
    given = {"T": place().tolist(), "intrinsics": INTRINSICS, "serial": "123", "rms": 0.0007, **fields}
    return Extrinsics.from_dict(given)


def test_saved_and_loaded(tmp_path):
    path = tmp_path / "extrinsics.json"
    first = extrinsics()
    first.save(path)
    assert Extrinsics.load(path) == first
    assert [each.name for each in tmp_path.iterdir()] == ["extrinsics.json"]
    data = json.loads(path.read_text())
    assert (data["parent"], data["child"]) == ("base", "camera")
    assert data["convention"].startswith("p_base = T p_camera")
    np.testing.assert_allclose(data["T"], place())
    assert datetime.fromisoformat(data["created"]).tzinfo is not None


def test_points3d_of_a_detection_lead_to_the_base_frame():
    image = np.full((480, 640, 3), 200, np.uint8)
    cv2.line(image, (200, 240), (440, 240), (20, 40, 200), 12)
    camera = extrinsics().camera(INTRINSICS)
    depth = np.full((480, 640), 700, np.uint16)
    shape = ShapeDetector(segmentation=HSVRange((100, 80, 40), (130, 255, 255))).detect(image, depth, camera).shapes[0]
    truth = INTRINSICS.deproject(shape.points2d, np.full(20, 0.7)) @ place()[:3, :3].T + place()[:3, 3]
    np.testing.assert_allclose(camera.to_base(np.asarray(shape.points3d)), truth, atol=1e-4)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"T": None}, "missing T; `shape-obs calibrate base` writes such files"),
        ({"T": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}, r"must be a rigid .*got shape \(3, 3\)"),
        ({"T": np.diag([2.0, 1, 1, 1]).tolist()}, "must be a rigid"),
        ({"T": [[1, 0, 0, "x"], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}, r"T\[0\]\[3\]: expected float, got 'x'"),
        ({"created": "yesterday"}, "expected a time such as 20.*, got 'yesterday'"),
        ({"parent": "camera", "child": "base"}, "invert T if it leads the other way"),
        ({"serialnumber": "1"}, "unknown field 'serialnumber'; did you mean 'serial'"),
    ],
)
def test_what_is_wrong_with_a_file_is_reported(tmp_path, change, message):
    data = {**extrinsics().to_dict(), **change}
    path = tmp_path / "e.json"
    path.write_text(json.dumps({key: value for key, value in data.items() if value is not None}))
    with pytest.raises(SpecError, match=message) as error:
        Extrinsics.load(path)
    assert str(path) in str(error.value)


def test_damaged_and_missing_files(tmp_path):
    path = tmp_path / "e.json"
    extrinsics().save(path)
    for text, message in ((path.read_text()[:200], "not valid JSON"), ("[]", "expected ")):
        path.write_text(text)
        with pytest.raises(SpecError, match=rf"e.json: .*{message}"):
            Extrinsics.load(path)
    with pytest.raises(FileNotFoundError, match="no such extrinsics file"):
        Extrinsics.load(tmp_path / "other.json")


class TestDoubts:
    def warned(self, given: Extrinsics, intrinsics=INTRINSICS, serial: str | None = "123") -> list[str]:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            for _ in range(3):
                given.camera(intrinsics, serial)
        assert all(each.category is ExtrinsicsWarning for each in caught)
        return [str(each.message) for each in caught]

    def test_old(self):
        then = (datetime.now(timezone.utc) - timedelta(days=40)).isoformat()
        assert ["measured 40 days ago, which is more than 30" in each for each in self.warned(extrinsics(created=then))]
        assert not self.warned(extrinsics(created=then, max_age_days=60))
        assert not self.warned(extrinsics(created=then[:19] + "Z", max_age_days=60))

    def test_another_camera_is_reported_once(self):
        assert self.warned(extrinsics(), serial="456") == ["the pose is that of camera 123, but this is camera 456."]
        assert not self.warned(extrinsics(), serial=None)
        assert not self.warned(extrinsics(serial=None), serial="456")

    def test_other_intrinsics(self):
        (warned,) = self.warned(extrinsics(), Intrinsics(640, 480, 400.0, 398.0, 321.0, 243.0))
        assert "fx 386.0" in warned
        assert "differ by 3.6 %" in warned
        assert not self.warned(extrinsics(), Intrinsics(640, 480, 387.5, 386.0, 320.0, 244.0))
        assert not self.warned(extrinsics(), Intrinsics(320, 240, 193.0, 192.5, 160.5, 121.5)), (
            "the same, half as large"
        )
        assert self.warned(extrinsics(), Intrinsics(848, 480, 386.0, 385.0, 425.0, 243.0))
