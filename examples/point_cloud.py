"""Find ordered points in an unordered cloud of a rope, without an image or a camera.

``detect_cloud`` takes the points of one object as an array (M, 3) of floats in metres. From Open3D that is
``np.asarray(pcd.points)``; from a ROS 2 PointCloud2,
``sensor_msgs_py.point_cloud2.read_points_numpy(message, field_names=("x", "y", "z"))``.
Neither is needed here: the cloud is synthetic.

Run: ``uv run examples/point_cloud.py``
"""

import numpy as np

from shape_obs import Centerline, ShapeDetector

RADIUS = 0.006
START = (0.25, 0.0, 0.60)


def made_up_cloud(m: int = 4000) -> np.ndarray:
    """Return points on a rope that rises in half a turn, (M, 3) in metres, shuffled, with 1 mm of noise."""
    rng = np.random.default_rng(0)
    t = rng.uniform(0, np.pi, m)
    axis = np.stack([START[0] * np.cos(t), START[0] * np.sin(t), START[2] + 0.05 * t], axis=1)
    around = rng.normal(size=(m, 3))
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    return axis + RADIUS * around + rng.normal(0, 0.001, (m, 3))


def main() -> None:
    cloud = made_up_cloud()
    # Point 0 lies at the end nearest the anchor, here a point in the cloud's own frame.
    detector = ShapeDetector([Centerline(n=20, ends="tips", anchor=START)])
    detection = detector.detect_cloud(cloud)
    rope = detection["centerline"]
    print(f"{len(cloud)} points in no order, ok: {rope.ok} {rope.reason}, in {detection.timings['total']:.1f} ms")
    points = rope.points3d  # (20, 3) metres, in the cloud's frame; NaN where the cloud has no points
    assert points is not None
    gaps = 1e3 * np.linalg.norm(np.diff(points, axis=0), axis=1)
    print("first, last:", points[0].round(3), points[-1].round(3))
    print(f"{len(points)} ordered points, gaps {gaps.min():.1f} ... {gaps.max():.1f} mm")
    print("all valid:", rope.valid.all(), "  points2d:", rope.points2d)


if __name__ == "__main__":
    main()
